"""The main accessibility checks: names, contrast, size of touch targets."""

# a script that runs in the page and returns a sentence for each fault
CHECKS = r"""
const faults = [], shown = (e) => e.getClientRects().length && getComputedStyle(e).visibility !== "hidden" && !e.closest(".skip");
const label = (e) => e.labels && e.labels.length ? e.labels[0].textContent : "";
const name = (e) => (e.getAttribute("aria-label") || label(e) || e.textContent || e.placeholder || "").trim();
const which = (e) => `${e.tagName.toLowerCase()}#${e.id}.${e.getAttribute("class")}`;
const tell = (what, e) => faults.push(`${what}: ${which(e)} "${(e.textContent || "").trim().slice(0, 30)}"`);
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
const linear = (v) => (v /= 255) <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4;
const lightness = ([r, g, b]) => .2126 * linear(r) + .7152 * linear(g) + .0722 * linear(b);
const ground = (e) => {
  for (; e; e = e.parentElement) { const c = parse(getComputedStyle(e).backgroundColor); if (c[3] === 1) return c; }
  return [255, 255, 255, 1];
};
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walker.nextNode()) {
  const e = walker.currentNode.parentElement;
  if (!walker.currentNode.textContent.trim() || !shown(e) || e.closest("svg, script, noscript") || e.closest(":disabled")) continue;
  const style = getComputedStyle(e), a = lightness(parse(style.color)), b = lightness(ground(e));
  const ratio = (Math.max(a, b) + .05) / (Math.min(a, b) + .05), size = parseFloat(style.fontSize);
  const large = size >= 24 || (size >= 18.6 && style.fontWeight >= 700);
  if (ratio < (large ? 3 : 4.5)) tell(`contrast ${ratio.toFixed(2)}`, e);
}
return faults;
"""
