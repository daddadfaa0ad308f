"use strict";
// Small screens begin with folded tables and contents.
const small = matchMedia("(max-width: 1099px)");
const contents = document.getElementById("contents");
const foldContents = () => { contents.open = !small.matches; };
foldContents();
small.addEventListener("change", foldContents);
if (matchMedia("(max-width: 699px)").matches) {
  for (const one of document.querySelectorAll("details.wide-open")) one.open = false;
}

// The target of a link is shown also if it is inside a folded part.
const reveal = () => {
  const target = location.hash && document.getElementById(location.hash.slice(1));
  if (!target) return;
  for (let one = target.parentElement; one; one = one.parentElement) {
    if (one.localName === "details") one.open = true;
  }
  target.scrollIntoView();
};
addEventListener("hashchange", reveal);
reveal();
contents.addEventListener("click", (event) => {
  if (small.matches && event.target.closest("a")) contents.open = false;
});

// A click on a figure shows it large.
const dialog = document.getElementById("large");
const links = [...document.querySelectorAll("a.zoom")];
let current = 0;
const show = (number) => {
  current = (number + links.length) % links.length;
  const image = links[current].querySelector("img");
  const large = dialog.querySelector("img");
  large.src = image.src;
  large.alt = dialog.querySelector("p").textContent = image.alt;
};
links.forEach((link, number) => link.addEventListener("click", (event) => {
  if (event.ctrlKey || event.metaKey || event.shiftKey) return;
  event.preventDefault();
  show(number);
  dialog.showModal();
}));
document.getElementById("previous").addEventListener("click", () => show(current - 1));
document.getElementById("next").addEventListener("click", () => show(current + 1));
dialog.addEventListener("keydown", (event) => {
  if (event.key === "ArrowLeft") show(current - 1);
  if (event.key === "ArrowRight") show(current + 1);
});
dialog.addEventListener("click", (event) => {
  if (event.target === dialog || event.target.localName === "img") dialog.close();
});
