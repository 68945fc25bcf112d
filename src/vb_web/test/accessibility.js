// The main accessibility checks, which run in the page: names, size of touch targets, unique ids, contrast.

const CONTROLS = "button, input, select, summary, a, [role=button], [tabindex='0']";

const isShown = (element) =>
  element.getClientRects().length && getComputedStyle(element).visibility !== "hidden" && !element.closest(".skip");

function nameOf(element) {
  const label = element.labels?.[0]?.textContent;
  return (element.getAttribute("aria-label") || label || element.textContent || element.placeholder || "").trim();
}

/** Returns [red, green, blue, alpha], 0 to 255 and 0 to 1, of a colour as getComputedStyle writes it. */
function parseColor(text) {
  const [red, green, blue, alpha = 1] = text.match(/[\d.]+/g).map(Number);
  return [red, green, blue, alpha];
}

/** Returns the colour behind an element: that of the nearest ancestor that is opaque. */
function backgroundOf(element) {
  for (let e = element; e; e = e.parentElement) {
    const color = parseColor(getComputedStyle(e).backgroundColor);
    if (color[3] === 1) return color;
  }
  return [255, 255, 255, 1];
}

/** Returns the relative luminance of WCAG 2.1, 0 to 1. */
function luminance([red, green, blue]) {
  const linear = (value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);
  return 0.2126 * linear(red / 255) + 0.7152 * linear(green / 255) + 0.0722 * linear(blue / 255);
}

function contrastOf(element) {
  const letters = luminance(parseColor(getComputedStyle(element).color));
  const ground = luminance(backgroundOf(element));
  return (Math.max(letters, ground) + 0.05) / (Math.min(letters, ground) + 0.05);
}

/** Returns the contrast that WCAG 2.1 requires: 3 for large letters, 4.5 for others. */
function requiredContrast(element) {
  const { fontSize, fontWeight } = getComputedStyle(element);
  const size = parseFloat(fontSize);
  return size >= 24 || (size >= 18.6 && fontWeight >= 700) ? 3 : 4.5;
}

/** Returns a sentence for each fault. */
function findFaults() {
  const faults = [];
  const report = (fault, element) => {
    const place = `${element.tagName.toLowerCase()}#${element.id}.${element.getAttribute("class")}`;
    faults.push(`${fault}: ${place} "${(element.textContent || "").trim().slice(0, 30)}"`);
  };
  for (const control of [...document.querySelectorAll(CONTROLS)].filter(isShown)) {
    if (!nameOf(control)) report("no name", control);
    const { width, height } = control.getBoundingClientRect();
    // a switch has an invisible rim that takes the finger, handles a circle
    const isPlain = control.tagName === "BUTTON" && !control.classList.contains("switch");
    if (isPlain && (width < 40 || height < 40)) report("smaller than 40 px", control);
  }
  const ids = [...document.querySelectorAll("[id]")].map((element) => element.id);
  for (const id of ids) if (ids.indexOf(id) !== ids.lastIndexOf(id)) faults.push(`twice: #${id}`);
  if (!document.documentElement.lang || !document.title) faults.push("no language or title");
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    const isLeftOut = element.closest("svg, script, noscript, :disabled");
    if (!walker.currentNode.textContent.trim() || !isShown(element) || isLeftOut) continue;
    const contrast = contrastOf(element);
    if (contrast < requiredContrast(element)) report(`contrast ${contrast.toFixed(2)}`, element);
  }
  return faults;
}
