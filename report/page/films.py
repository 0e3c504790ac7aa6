"""Films: of each scene that has one, the camera path by several methods side by side.

`gpf stage animate` has made them as pictures that move. They share the page's bytes with the
flip-books: where not all views fit beside them, films have half their size along each side; and
before the images of flip-books are shrunk for them, they are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path

from PIL import Image

from gpf.core.errors import UserError
from report.page.books import Shelf, ViewMaker, make_books
from report.page.embedding import to_uri
from report.results import Results, SceneResults
from report.tables.flicker import title_of


@dataclass(frozen=True)
class Film:
    """A picture that moves, and what can be said of it.

    Attributes
    ----------
    moving, still: data URIs of the picture and of its first frame.
    width, height: of the file on disk, pixels, whatever the size of what is shown.
    frames: how many there are.
    methods: titles of those that are shown.
    missing: titles of those that could not serve the scene, with the reason why.
    file: the picture.
    halved: whether it is shown at half its size.
    """

    scene: str
    moving: str
    still: str
    width: int
    height: int
    frames: int
    methods: list[str]
    missing: dict[str, str]
    file: Path
    halved: bool = False

    @property
    def size(self) -> int:
        """Bytes of both pictures."""
        return len(self.moving) + len(self.still)

    @property
    def film(self) -> Path:
        """The same at more pixels, as a file for players."""
        return self.file.with_suffix(".mp4")


def open_films(results: Results) -> dict[str, Film]:
    """The films that there are of the scenes that `animation` asks for, by scene."""
    asked = results.params.animation.scenes
    scenes = [results.scene(name) for name in results.scenes if name in asked]
    return {s.name: _open(results, s) for s in scenes if _file(s).exists()}


def share_room(
    results: Results, films: dict[str, Film], most_bytes: int
) -> tuple[dict[str, Film], Shelf]:
    """Films and flip-books that have at most so many bytes, as far as they can give way."""
    maker = ViewMaker(results)

    def fill(chosen: dict[str, Film]) -> tuple[Shelf, bool]:
        """The books beside these films, and whether both fit."""
        room = most_bytes - sum(film.size for film in chosen.values())
        shelf = make_books(results, room, maker)
        return shelf, shelf.size <= room

    shelf, fits = fill(films)
    if films and not (shelf.is_whole and fits):
        films = {scene: halve(film) for scene, film in films.items()}
        shelf, fits = fill(films)
    if films and not (shelf.shrunk == 1 and fits):
        bare, _ = fill({})
        if bare.shrunk < shelf.shrunk or not fits:
            return {}, bare
    return films, shelf


def halve(film: Film) -> Film:
    """The film at half its size along each side."""
    with Image.open(film.file) as picture:
        size = max(1, picture.width // 2), max(1, picture.height // 2)
        frames, times = [], []
        for number in range(film.frames):
            picture.seek(number)
            frames.append(picture.convert("RGB").resize(size, Image.Resampling.LANCZOS))
            times.append(picture.info.get("duration", 100))
    moving = BytesIO()
    frames[0].save(
        moving,
        "WEBP",
        save_all=True,
        append_images=frames[1:],
        duration=times,
        loop=0,
        quality=60,
        method=4,
    )
    moving_uri, still = to_uri(moving.getvalue(), "webp"), _still(frames[0])
    return replace(film, moving=moving_uri, still=still, halved=True)


def _open(results: Results, scene: SceneResults) -> Film:
    file = _file(scene)
    try:
        data = file.read_bytes()
        with Image.open(BytesIO(data)) as picture:
            width, height = picture.size
            frames = getattr(picture, "n_frames", 1)
            still = _still(picture.convert("RGB"))
    except OSError as error:
        raise UserError(
            str(file),
            f"cannot be read as a picture ({error.strerror or error})",
            f"Run `gpf stage animate --scene {scene.name}` again.",
        ) from error
    asked = results.params.animation.methods
    told = scene.read("animation", "flicker.json").get("methods") or {m: {} for m in asked}
    order = [*(m for m in asked if m in told), *(m for m in told if m not in asked)]
    reasons = {m: told[m].get("cannot_serve") for m in order}
    return Film(
        scene.name,
        to_uri(data, "webp"),
        still,
        width,
        height,
        frames,
        [title_of(results, m) for m in order if not reasons[m]],
        {title_of(results, m): str(why) for m, why in reasons.items() if why},
        file,
    )


def _file(scene: SceneResults) -> Path:
    return scene.folder / "animation" / "animation.webp"


def _still(frame: Image.Image) -> str:
    stream = BytesIO()
    frame.save(stream, "WEBP", quality=80, method=6)
    return to_uri(stream.getvalue(), "webp")
