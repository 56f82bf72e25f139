// Draws the curves of #history, and moves the lines between photographs and renders.
"use strict";
(() => {
  splatCurves(...JSON.parse(document.getElementById("history").textContent));

  for (const box of document.querySelectorAll(".comparison")) {
    const input = box.querySelector("input");
    input.oninput = () => box.style.setProperty("--cut", `${input.value}%`);
  }
})();
