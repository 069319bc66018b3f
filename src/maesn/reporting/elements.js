"use strict";

// Elements of a page, those of pictures included. Texts are set as text: they cannot become markup.
const SVG = new Set(["svg", "g", "path", "circle", "rect", "text", "title"]);

function make(name, attributes = {}, ...children) {
  const isSvg = SVG.has(name);
  const node = isSvg ? document.createElementNS("http://www.w3.org/2000/svg", name) : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else node.setAttribute(key, value);
  }
  node.append(...children);
  return node;
}
