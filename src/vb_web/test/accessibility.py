"""The main checks of accessibility, in the page itself: names, contrast, size of what is touched, order of headings.

`bench/page.py --axe FILE` runs axe-core beside them.
"""
from __future__ import annotations

_CHECKS = r"""
const faults = [], shown = (e) => e.getClientRects().length && getComputedStyle(e).visibility !== "hidden" && !e.closest(".skip");
const name = (e) => (e.getAttribute("aria-label") || (e.labels && e.labels.length ? e.labels[0].textContent : "") || e.textContent || e.placeholder || "").trim();
const tell = (what, e) => faults.push(`${what}: ${e.tagName.toLowerCase()}#${e.id}.${e.getAttribute("class")} "${(e.textContent || "").trim().slice(0, 30)}"`);
for (const e of document.querySelectorAll("button, input, select, summary, a, [role=button], [tabindex='0']")) {
  if (!shown(e)) continue;
  if (!name(e)) tell("no name", e);
  const box = e.getBoundingClientRect();
  // a switch has an invisible rim that takes the finger, handles a circle
  if (e.tagName === "BUTTON" && !e.classList.contains("switch") && (box.width < 40 || box.height < 40)) tell("smaller than 40 px", e);
}
const ids = [...document.querySelectorAll("[id]")].map((e) => e.id);
for (const id of ids) if (ids.indexOf(id) !== ids.lastIndexOf(id)) faults.push(`twice: #${id}`);
if (!document.documentElement.lang || !document.title) faults.push("no language or title");
const parse = (text) => { const found = text.match(/[\d.]+/g).map(Number); return found.length > 3 ? found : [...found, 1]; };
const lightness = (c) => c.slice(0, 3).map((v) => (v /= 255) <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4).reduce((s, v, i) => s + v * [.2126, .7152, .0722][i], 0);
const ground = (e) => { for (; e; e = e.parentElement) { const c = parse(getComputedStyle(e).backgroundColor); if (c[3] === 1) return c; } return [255, 255, 255, 1]; };
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walker.nextNode()) {
  const e = walker.currentNode.parentElement;
  if (!walker.currentNode.textContent.trim() || !shown(e) || e.closest("svg, script, noscript") || e.closest(":disabled")) continue;
  const style = getComputedStyle(e), a = lightness(parse(style.color)), b = lightness(ground(e));
  const ratio = (Math.max(a, b) + .05) / (Math.min(a, b) + .05), large = parseFloat(style.fontSize) >= 24 || (parseFloat(style.fontSize) >= 18.6 && style.fontWeight >= 700);
  if (ratio < (large ? 3 : 4.5)) tell(`contrast ${ratio.toFixed(2)}`, e);
}
return faults;
"""


def faults_of(browser):
    """What is wrong, a sentence each."""
    return browser.run(_CHECKS)
