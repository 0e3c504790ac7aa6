// Starts flip-books, films, sortable tables, keys, and the marking of the current section.

document.documentElement.classList.add("live");

const content = JSON.parse(document.getElementById("content").textContent);
const roots = [...document.querySelectorAll(".book")];
const books = roots.map((root, k) => new FlipBook(root, content.books[k], content.errors));

for (const root of document.querySelectorAll(".film")) root.film = new Film(root);

for (const table of document.querySelectorAll("main table")) makeSortable(table);

// Keys act on the flip-book with the focus, else on the one in sight.
document.addEventListener("keydown", (e) => {
  const own = books.find((book) => book.root.contains(e.target));
  const free = e.target === document.body || e.target === document.documentElement;
  const book = own ?? (free ? mostInSight() : null);
  if (book?.key(e)) e.preventDefault();
});
document.addEventListener("keyup", (e) => {
  if (e.key.toLowerCase() !== "r") return;
  for (const book of books) if (book.state.held) book.set({ held: false });
});

function mostInSight() {
  const seen = (book) => {
    const { top, bottom } = book.canvas.getBoundingClientRect();
    return Math.min(bottom, window.innerHeight) - Math.max(top, 0);
  };
  const [best] = [...books].sort((a, b) => seen(b) - seen(a));
  return best && seen(best) > 0 ? best : null;
}

// Mark the link to the section in sight.
const bar = document.querySelector("nav");
const links = new Map([...bar.querySelectorAll("a")].map((link) => [link.hash.slice(1), link]));
const reading = new IntersectionObserver((entries) => {
  for (const { target } of entries.filter((entry) => entry.isIntersecting)) {
    for (const link of links.values()) link.removeAttribute("aria-current");
    const link = links.get(target.id);
    link.setAttribute("aria-current", "true");
    bar.scrollLeft = link.offsetLeft - (bar.clientWidth - link.clientWidth) / 2;
  }
}, { rootMargin: "-30% 0px -65% 0px" });
for (const id of links.keys()) {
  const part = document.getElementById(id);
  if (part) reading.observe(part);
}
