"""Flip-books: the images of all methods in some novel views of each scene, within a size limit.

The first view of each scene is its typical view, where the field's PSNR is closest to its mean.
Then come the view with the field's lowest PSNR and the other views, one of each scene in turn, as
long as there is room. If the typical views alone are too large, all pictures are shrunk.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gpf.core.images import read_exr
from report.page.pictures import Picture, encode, shrink
from report.results import FIELD, SECOND_REFERENCE, Results, SceneResults

REFERENCE = "reference"
NO_IMAGES = "no image files"
SMALLEST = 16
"""Smallest side of a shrunk picture, pixels."""

WHY = {
    "typical": "“{}” is the typical view, where the field's PSNR is closest to its mean",
    "worst": "in “{}” it is lowest",
}


@dataclass(frozen=True)
class BookView:
    """A view of a flip-book: why it was chosen, and method -> metrics and picture."""

    name: str
    why: str
    numbers: Mapping[str, Mapping[str, float]]
    pictures: Mapping[str, Picture]

    @property
    def size(self) -> int:
        """Size of the pictures, bytes."""
        return sum(len(picture.data) for picture in self.pictures.values())


@dataclass
class Book:
    """A scene's flip-book.

    Attributes
    ----------
    exposure: factor of the radiance, the same as in the metrics.
    methods: name -> title of the methods with pictures, in the order of the flip-book.
    missing: reason -> titles of the methods without pictures.
    left_out: names of the views for which there was no room.
    """

    scene: str
    title: str
    exposure: float
    methods: dict[str, str]
    missing: dict[str, list[str]]
    views: list[BookView] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    @property
    def aspect(self) -> float:
        """Width over height."""
        picture = next(iter(self.views[0].pictures.values()))
        return picture.width / picture.height


@dataclass(frozen=True)
class Shelf:
    """All flip-books; their pictures are ``shrunk`` times smaller along each side."""

    books: list[Book]
    shrunk: int = 1

    @property
    def size(self) -> int:
        """Size of all pictures, bytes."""
        return sum(view.size for book in self.books for view in book.views)

    @property
    def is_whole(self) -> bool:
        """Whether all views are included, at full size."""
        return self.shrunk == 1 and not any(book.left_out for book in self.books)


class ViewMaker:
    """Encodes the pictures of views, and keeps them for later calls."""

    def __init__(self, results: Results) -> None:
        self.results = results
        self.made: dict[tuple[str, str, int], BookView] = {}

    def make(self, scene: SceneResults, name: str, why: str, factor: int) -> BookView:
        """A view with all its pictures, ``factor`` times smaller along each side."""
        place = scene.name, name, factor
        if place not in self.made:
            self.made[place] = _make_view(self.results, scene, name, why, factor)
        return self.made[place]


def make_books(results: Results, most_bytes: int, maker: ViewMaker | None = None) -> Shelf:
    """The flip-books of all scenes with images, at most ``most_bytes`` if possible.

    Parameters
    ----------
    maker: may hold encoded views from earlier calls.
    """
    maker = maker or ViewMaker(results)
    scenes = [results.scene(name) for name in results.scenes]
    orders = {s.name: order_views(s) for s in scenes}
    orders = {name: order for name, order in orders.items() if order}
    scenes = [s for s in scenes if s.name in orders]
    factor = 1
    while True:
        firsts = {s.name: maker.make(s, *orders[s.name][0], factor) for s in scenes}
        shelf = Shelf([_make_book(results, s, firsts[s.name]) for s in scenes], factor)
        sides = [min(p.width, p.height) for v in firsts.values() for p in v.pictures.values()]
        if shelf.size <= most_bytes or min(sides, default=0) < 2 * SMALLEST:
            break
        factor *= 2
    for turn in range(1, max(map(len, orders.values()), default=0)):
        for scene, book in zip(scenes, shelf.books, strict=True):
            if turn < len(orders[scene.name]):
                view = maker.make(scene, *orders[scene.name][turn], factor)
                if shelf.size + view.size <= most_bytes:
                    book.views.append(view)
                else:
                    book.left_out.append(view.name)
    return shelf


def order_views(scene: SceneResults) -> list[tuple[str, str]]:
    """The novel views with a reference, in order, and why each has its place (or "")."""
    if not scene.image(REFERENCE, "").parent.is_dir():  # views.yaml may be missing, too
        return []
    names = [v.name for v in scene.views.novel if scene.image(REFERENCE, v.name).exists()]
    found = scene.read("metrics", f"{FIELD}.json")
    psnr = {name: n["psnr"] for name, n in found.get("views", {}).items() if name in names}
    if len(psnr) < len(names) or len(names) < 2:
        return [(name, "") for name in names]
    mean = np.mean(list(psnr.values()))
    typical = min(names, key=lambda name: abs(psnr[name] - mean))
    worst = min((name for name in names if name != typical), key=lambda name: psnr[name])
    rest = [(name, "") for name in names if name not in (typical, worst)]
    return [(typical, WHY["typical"].format(typical)), (worst, WHY["worst"].format(worst)), *rest]


def read_image(results: Results, scene: SceneResults, method: str, view: str) -> np.ndarray | None:
    """Radiance (H, W, 3); None if there is no file."""
    path = scene.image(method, view)
    if not path.exists():
        return None
    layers, _ = read_exr(path)
    # The second reference has a layer for each of several numbers of passes.
    name = f"sppm_{max(scene.convergence, default=0)}" if method == SECOND_REFERENCE else "radiance"
    return layers.get(name)


def _titles(results: Results) -> dict[str, str]:
    """Titles of all methods in the order of a flip-book: references, field, others."""
    titles = {REFERENCE: "Reference", FIELD: results.methods[FIELD]}
    titles[SECOND_REFERENCE] = f"Second reference: {results.methods[SECOND_REFERENCE]}"
    return titles | {m: title for m, title in results.methods.items() if m not in titles}


def _make_view(results: Results, scene: SceneResults, name: str, why: str, factor: int) -> BookView:
    numbers: dict[str, dict[str, float]] = {}
    pictures: dict[str, Picture] = {}
    for method in _titles(results):
        image = read_image(results, scene, method, name)
        views = scene.read("metrics", f"{method}.json").get("views", {})
        if image is not None and (method == REFERENCE or name in views):
            small = shrink(image, factor) if factor > 1 else image
            pictures[method] = encode(small, str(scene.image(method, name)))
            numbers[method] = _known(views.get(name, {}))
    return BookView(name, why, numbers, pictures)


def _known(numbers: Mapping[str, Any]) -> dict[str, float]:
    return {key: value for key, value in numbers.items() if isinstance(value, float)}


def _make_book(results: Results, scene: SceneResults, first: BookView) -> Book:
    titles = _titles(results)
    missing: dict[str, list[str]] = {}
    for method in (m for m in titles if m not in first.pictures):
        reason = results.reasons(scene.name, method).get("", NO_IMAGES)
        missing.setdefault(reason, []).append(titles[method])
    shown = {m: title for m, title in titles.items() if m in first.pictures}
    return Book(scene.name, scene.title, scene.views.exposure, shown, missing, views=[first])


def map_pictures(shelf: Shelf, use: Callable[[Picture], str]) -> list[dict[str, Any]]:
    """The books as JSON values for `flipbook.js`; ``use`` gives the id of each picture."""
    return [
        {
            "scene": book.scene,
            "title": book.title,
            "start": FIELD if FIELD in book.methods else REFERENCE,
            "exposure": book.exposure,
            "methods": [{"name": m, "title": title} for m, title in book.methods.items()],
            "views": [
                {
                    "name": view.name,
                    "numbers": view.numbers,
                    "pictures": {
                        m: {"width": p.width, "height": p.height, "id": use(p)}
                        for m, p in view.pictures.items()
                    },
                }
                for view in book.views
            ],
        }
        for book in shelf.books
    ]
