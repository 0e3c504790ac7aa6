"""The cameras that `gpf render` is asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import mitsuba as mi

from gpf.blender.conversion import origin_of
from gpf.core.errors import UserError
from gpf.core.progress import say
from gpf.placement.loops import place_orbit
from gpf.scene.frames import choose_frames
from gpf.scene.sensors import film_aspect, scene_cameras, shown_differently, views_of_sensors
from gpf.scene.transforms import read_cameras
from gpf.scene.views import SceneViews, View, ViewSets


@dataclass(frozen=True)
class CameraChoice:
    """Which cameras to use; by default, the novel views of the file or, without any, all.

    Attributes
    ----------
    names: names of views.
    file: ``views.yaml`` or ``transforms.json``; None for the one beside the scene, if there is one.
    frames: frames of the file's camera path: ``all``, or ``FIRST:LAST`` for FIRST to LAST-1, from
        0.
    orbit: number of cameras around what the scene's own camera looks at; 0 for none.
    """

    names: tuple[str, ...] = ()
    file: Path | None = None
    frames: str | None = None
    orbit: int = 0


@dataclass(frozen=True)
class Cameras:
    """Views, the width of their images divided by the height, and their exposure, if known."""

    views: tuple[View, ...]
    aspect: float
    exposure: float | None = field(default=None)


def file_beside(scene_file: Path, file: Path | None) -> Path | None:
    """The cameras' file: ``file``, or else ``views.yaml`` beside the scene, or in the folder of an
    animation, if there is one; for a converted scene in the cache, first beside the file that it
    was made from."""
    folders = (
        path if path.is_dir() else path.parent for path in (origin_of(scene_file), scene_file)
    )
    places = (folder / "views.yaml" for folder in folders)
    return file or next((place for place in places if place.exists()), None)


def choose_cameras(scene: mi.Scene, scene_file: Path, choice: CameraChoice) -> Cameras:
    """The cameras for pictures of a scene.

    Raises
    ------
    UserError: there is no such view, file, path or camera, or several ways to choose are given.
    """
    ways = [
        name for name, given in (("--frames", choice.frames), ("--orbit", choice.orbit)) if given
    ]
    ways += ["--view"] if choice.names else []
    if len(ways) > 1:
        raise UserError(" and ".join(ways), "are mutually exclusive", "Give one of them.")
    file = file_beside(scene_file, choice.file)
    known = known_cameras(scene, scene_file, file)
    for what in shown_differently(scene) if file is None else ():
        say(what)
    where = str(file or scene_file)
    if choice.orbit:
        own = views_of_sensors(scene) or list(known.train)
        views = place_orbit(scene, own[0], known.aspect, choice.orbit)
    elif choice.frames:
        views = _frames(choice.frames, known.frames(), where)
    elif choice.names:
        views = tuple(known.find(name) for name in choice.names)
    else:
        views = known.novel or (*known.train, *known.more)
    return Cameras(views, known.aspect, known.given_exposure)


def camera_of_frame(
    scene: mi.Scene, scene_file: Path, choice: CameraChoice, frame: str, number: int
) -> Cameras:
    """The camera of a frame of an animation, as a view with the frame's name: the view that is
    named; else, if the cameras' file has a path, its frame with this number; else the scene's own.

    Raises
    ------
    UserError: as :func:`choose_cameras`; or the path is too short.
    """
    file = file_beside(scene_file, choice.file)
    known = known_cameras(scene, scene_file, file)
    if choice.names:
        view = known.find(choice.names[0])
    elif known.path is not None:
        view = _frames(f"{number}:{number + 1}", known.frames(), str(file))[0]
    else:
        view = known_cameras(scene, scene_file, None).train[0]
    return Cameras((view.model_copy(update={"name": frame}),), known.aspect, known.given_exposure)


def _frames(wanted: str, path: tuple[View, ...], where: str) -> tuple[View, ...]:
    """Frames of a camera path."""
    if not path:
        raise UserError(where, "has no camera path", "Add a path, or leave out --frames.")
    return path[choose_frames(wanted, len(path), "the path")]


def known_cameras(scene: mi.Scene, scene_file: Path, file: Path | None) -> SceneViews:
    """The cameras of a file or, without one, those of the scene.

    Raises
    ------
    UserError: there are none.
    """
    if file is not None:
        return read_cameras(file)
    own = views_of_sensors(scene)
    if not own:
        raise UserError(
            str(scene_file), "has no perspective camera", "Add a <sensor>, or give --views FILE."
        )
    aspect = round(film_aspect(scene_cameras(scene)[0]), 6)
    return SceneViews(aspect=aspect, views=ViewSets(train=tuple(own)))
