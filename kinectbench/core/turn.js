"use strict";
// Strips of pictures from all around: a drag over the whole width, or the arrow keys, turn the object.
document.querySelectorAll(".turn").forEach(box => {
  const frames = Number(box.dataset.frames), strip = box.firstElementChild;
  let at = 0, from = null;
  const show = to => {
    at = (Math.round(to) % frames + frames) % frames;
    strip.style.transform = `translateX(${-100 * at / frames}%)`;
  };
  box.addEventListener("pointerdown", event => { from = [event.clientX, at]; box.setPointerCapture(event.pointerId); });
  box.addEventListener("pointermove", event => {
    if (from) show(from[1] - (event.clientX - from[0]) / box.clientWidth * frames);
  });
  ["pointerup", "pointercancel"].forEach(name => box.addEventListener(name, () => { from = null; }));
  box.addEventListener("keydown", event => {
    const step = { ArrowLeft: 1, ArrowRight: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    show(at + step);
  });
});
