"""Films: the camera path of a scene, rendered by several methods side by side.

`gpf stage animate` writes them as animated WebP. They share the size limit of the page with the
flip-books. If not all views fit, films are halved along each side; films are left out before
images of flip-books are shrunk.
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
    """An animated picture.

    Attributes
    ----------
    moving, still: data URIs of the animation and of its first frame.
    width, height: of the file on disk, pixels, even if the film is halved.
    frames: number of frames.
    methods: titles of the methods in it.
    missing: title -> reason, for methods that could not serve the scene.
    file: the file on disk.
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
        """Size of both data URIs, bytes."""
        return len(self.moving) + len(self.still)

    @property
    def film(self) -> Path:
        """The video file, which has more pixels, for players."""
        return self.file.with_suffix(".mp4")


def open_films(results: Results) -> dict[str, Film]:
    """Scene -> film, for the measured scenes of `animation` that have one."""
    asked = results.params.animation.scenes
    scenes = [results.scene(name) for name in results.scenes if name in asked]
    return {s.name: _open(results, s) for s in scenes if _file(s).exists()}


def share_room(
    results: Results, films: dict[str, Film], most_bytes: int
) -> tuple[dict[str, Film], Shelf]:
    """The films and flip-books for the page, at most ``most_bytes`` if possible."""
    maker = ViewMaker(results)

    def fill(chosen: dict[str, Film]) -> tuple[Shelf, bool]:
        """The flip-books with these films, and whether both fit."""
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
    """The film with half its size along each side."""
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
    numbers = scene.read("flicker.json").get("methods") or {m: {} for m in asked}
    order = [*(m for m in asked if m in numbers), *(m for m in numbers if m not in asked)]
    reasons = {m: numbers[m].get("cannot_serve") for m in order}
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
