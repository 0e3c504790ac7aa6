// Films that move unless somebody prefers less motion; a click stops them and sets them going.

const calm = window.matchMedia("(prefers-reduced-motion: reduce)");

class Film {
  constructor(root) {
    this.root = root;
    this.source = root.querySelector("source"); // the first frame, where its media fit
    this.button = root.querySelector("button");
    for (const part of [this.button, root.querySelector("picture")]) {
      part.addEventListener("click", () => this.play(!this.plays));
    }
    calm.addEventListener("change", () => this.play(!calm.matches));
    this.play(!calm.matches);
  }

  get plays() { return this.root.dataset.plays === "true"; }

  play(on) {
    this.root.dataset.plays = on;
    this.source.media = on ? "print" : "all";
    this.button.textContent = on ? "Pause" : "Play";
  }
}
