"""`results/report.html`: texts, tables, figures, films and flip-books in one file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from gpf.core.errors import UserError
from gpf.core.files import write_text
from report.figures.pictures import ERRORS, LARGEST_ERROR
from report.page.books import Book, Shelf, map_pictures, order_views, read_image
from report.page.embedding import Embedded, embed_figure, embed_radiance
from report.page.films import Film, open_films, share_room
from report.page.origin import list_commits, list_machines, list_seeds, write_params
from report.page.pictures import PRECISION, Picture
from report.page.systems import list_systems
from report.page.words import SceneWords, describe_best, describe_scene, main_numbers
from report.results import FIELD, Results, SceneResults
from report.tables.quality import scenes_left_out
from report.writing import to_html

if TYPE_CHECKING:
    from report.figures import Figure
    from report.table import Table

MOST_BYTES = 25_000_000
HERE = Path(__file__).parent
SCRIPTS = ("codec.js", "flipbook.js", "films.js", "tables.js", "start.js")
COST_FIGURES = ("quality_time", "cumulative_cost")
COST_TABLES = ("table_4", "costs", "equal_time", "equal_quality")
OPENING = "teaser"


@dataclass(frozen=True)
class ScenePart:
    """A scene on the page."""

    name: str
    title: str
    words: SceneWords
    poster: Embedded | None
    poster_view: str
    book: Book | None
    figures: list[tuple[Figure, Embedded | None]]
    film: Film | None = None
    film_left_out: bool = False


def write_page(
    results: Results,
    tables: Sequence[Table],
    figures: Sequence[Figure],
    path: Path,
    most_bytes: int = MOST_BYTES,
) -> None:
    """Write the page atomically, with at most ``most_bytes``.

    Texts, tables and figures are always complete; films and flip-books use the remaining bytes
    (:mod:`report.page.films`, :mod:`report.page.books`).

    Raises
    ------
    UserError: the file of a figure is missing, or the page is too large even without films and
        flip-books.
    """
    embedded = {figure.name: (figure, embed_figure(figure)) for figure in figures}
    parts = _scene_parts(results, embedded)
    bare = len(_render(results, tables, embedded, parts, Shelf([])).encode())
    room = most_bytes - bare - _surroundings(results)
    if room < 0:
        raise UserError(
            str(path),
            f"would take {bare / 1e6:.1f} MB even without flip-books, but the limit is "
            f"{most_bytes / 1e6:.1f} MB",
            "Make the figures smaller.",
        )
    films = open_films(results)
    shown, shelf = share_room(results, films, room)
    scenes = [
        replace(part, film=shown.get(part.name), film_left_out=part.name in films.keys() - shown)
        for part in _scene_parts(results, embedded, shelf)
    ]
    text = _render(results, tables, embedded, scenes, shelf)
    write_text(path, text)


def _render(
    results: Results,
    tables: Sequence[Table],
    embedded: dict[str, tuple[Figure, Embedded | None]],
    scenes: Sequence[ScenePart],
    shelf: Shelf,
) -> str:
    """The text of the page."""
    pictures: dict[str, Picture] = {}

    def keep(picture: Picture) -> str:
        name = f"picture-{len(pictures)}"
        pictures[name] = picture
        return name

    # Error maps have the same colours as in the figures.
    errors = {"colours": _colours(1024).reshape(-1).tolist(), "largest": LARGEST_ERROR}
    content = {"books": map_pictures(shelf, keep), "errors": errors}
    elsewhere = {OPENING, *COST_FIGURES, *(f.name for s in scenes for f, _ in s.figures)}
    environment = Environment(
        loader=FileSystemLoader(HERE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("template.html").render(
        style=_read("style.css"),
        scripts=Markup("\n").join(_read(name) for name in SCRIPTS),
        content=_json(content),
        pictures=pictures,
        gradient=_gradient(),
        largest_error=LARGEST_ERROR,
        numbers=main_numbers(results),
        best_everywhere=describe_best(results),
        scenes=scenes,
        left_out=scenes_left_out(results),
        shrunk=shelf.shrunk,
        passes=results.passes,
        height=results.params.film.height,
        systems=list_systems(results),
        opening=embedded.get(OPENING),
        cost_figures=[embedded[name] for name in COST_FIGURES if name in embedded],
        figures=[pair for name, pair in embedded.items() if name not in elsewhere],
        cost_tables=[_with_html(t) for t in tables if t.name in COST_TABLES],
        tables=[_with_html(t) for t in tables if t.name not in COST_TABLES],
        machines=list_machines(results),
        commits=list_commits(results),
        seeds=list_seeds(results),
        params=write_params(results),
        precision=PRECISION,
    )


def _scene_parts(
    results: Results,
    embedded: dict[str, tuple[Figure, Embedded | None]],
    shelf: Shelf | None = None,
) -> list[ScenePart]:
    books = {book.scene: book for book in shelf.books} if shelf else {}
    parts = []
    for scene in map(results.scene, results.scenes):
        view, poster = _poster(results, scene)
        figures = [pair for pair in embedded.values() if pair[0].scene == scene.name]
        words, book = describe_scene(results, scene), books.get(scene.name)
        parts.append(ScenePart(scene.name, scene.title, words, poster, view, book, figures))
    return parts


def _poster(results: Results, scene: SceneResults) -> tuple[str, Embedded | None]:
    """The typical view, and its image by the field, or its reference if there is none."""
    for view, _ in order_views(scene)[:1]:
        for method in (FIELD, "reference"):
            image = read_image(results, scene, method, view)
            if image is not None:
                return view, embed_radiance(image, scene.views.exposure)
    return "", None


def _surroundings(results: Results) -> int:
    """Upper bound for the bytes of all flip-books and films without the data of their pictures."""
    views = sum(len(order_views(results.scene(name))) for name in results.scenes)
    return 10_000 * len(results.scenes) + 400 * views * (len(results.methods) + 1)


def _with_html(table: Table) -> tuple[Table, Markup]:
    """A table and its HTML; a span keeps the caption in sight while the table scrolls sideways."""
    html = to_html(table).replace("<caption>", "<caption><span>")
    return table, Markup(html.replace("</caption>", "</span></caption>"))


def _read(name: str) -> Markup:
    return Markup((HERE / name).read_text(encoding="utf-8"))


def _json(value: Any) -> Markup:
    """JSON without `<`, which could end the script element."""
    return Markup(json.dumps(value, separators=(",", ":")).replace("<", "\\u003c"))


def _colours(count: int) -> np.ndarray:
    """Colours of ``count`` errors from 0 to the largest: RGB from 0 to 255, (count, 3)."""
    return np.asarray(ERRORS.to_rgba(np.linspace(0, LARGEST_ERROR, count), bytes=True))[:, :3]


def _gradient() -> str:
    """The same colours as a CSS gradient."""
    return ", ".join(f"rgb({red},{green},{blue})" for red, green, blue in _colours(33))
