// Films. They play unless the user prefers reduced motion; a click pauses and plays them.

const calm = window.matchMedia("(prefers-reduced-motion: reduce)");

class Film {
  constructor(root) {
    this.root = root;
    this.source = root.querySelector("source"); // shows the first frame if its media query matches
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
