"""`gpf view`: a page in the browser that shows a scene from a field."""

from __future__ import annotations

import math
import signal
import tempfile
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi

from gpf.commands.cameras import file_beside, known_cameras
from gpf.commands.fit import require_field_name
from gpf.commands.scenes import find_field, find_scene, require_same_scene, title_of
from gpf.core.errors import FileError, UserError, is_interrupt
from gpf.core.locks import sole_run
from gpf.core.partial import remove_leftovers
from gpf.core.progress import say
from gpf.core.runtime import choose_variant
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field
from gpf.scene.light_groups import LightGroups
from gpf.scene.load import load_scene_file
from gpf.scene.pinhole import find_focal
from gpf.scene.untraceable import telling_untraceable
from gpf.scene.views import SceneViews, View, read_views
from gpf.viewing.background_fit import BackgroundFit
from gpf.viewing.references import References
from gpf.viewing.server import PageServer
from gpf.viewing.subject import Subject
from gpf.viewing.viewer import Viewer

# Ctrl-C, `kill`, and the closing of the terminal.
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclass(frozen=True)
class ServerOptions:
    """Host and port of the page, 0 for any free port, and whether to open it in a browser."""

    host: str
    port: int
    opens: bool


def view_scene(
    scene_name: str,
    field_name: str | None,
    out: Path,
    views_file: Path | None,
    options: ServerOptions,
    changed_scene: bool = False,
    groups: str = "",
) -> None:
    """Show a scene until Ctrl-C.

    Parameters
    ----------
    scene_name: as for :func:`gpf.commands.scenes.find_scene`; a scene of the pipeline is shown with
        its field and its references.
    field_name: as for :func:`gpf.commands.scenes.find_field`; None to use the one in ``out`` or, if
        there is none, to fit one and write it there.
    views_file: cameras to jump to, and where cameras are saved. By default, those beside the scene,
        and ``NAME.views.yaml`` in the current folder, which other commands do not take by
        themselves.
    changed_scene: whether to accept a field of another scene.
    groups: if a field is fitted, groups of emitters whose light is kept apart
        (:meth:`LightGroups.parse`).

    Raises
    ------
    UserError: a file is wrong, the field is for another scene, or the port cannot be used.
    """
    scene_file, trained = find_scene(scene_name)
    field_file = find_field(field_name, trained) if field_name or trained else None
    if field_file is None:
        require_field_name(out)
        if groups and out.exists():
            raise UserError(str(out), "already exists", "Choose another name with --output.")
    elif groups:
        raise UserError(
            "--groups",
            "cannot be used with an existing field",
            "Fit one with `gpf fit --groups`, then view it.",
        )
    choose_variant("auto")
    field = None if field_file is None else load_field(field_file)
    scene = load_scene_file(scene_file)
    LightGroups.parse(groups, scene)  # reports errors before the fit starts
    if field is not None and field_file is not None:
        require_same_scene(scene, scene_file, field, field_file, changed_scene)
    elif out.exists():
        field = _load_kept(out, scene, scene_file, changed_scene)
    # A file that does not exist yet is only where cameras will be saved.
    given = views_file if views_file is not None and views_file.exists() else None
    folder = trained or scene_file.parent
    file = file_beside(folder / scene_file.name, given)
    subject = _subject(scene, scene_name, known_cameras(scene, scene_file, file), views_file)
    if trained is not None:
        made = [(c, trained / "reference" / f"{c.name}.exr") for c in subject.cameras]
        subject.references = References((camera, exr) for camera, exr in made if exr.exists())
    if subject.exposure is None and field is not None:
        subject.exposure = field.record.get("exposure")
    fits = _fit(scene_file, out, file, groups) if field is None else nullcontext()
    with _ended_by_signals(), fits as fit:
        try:
            _serve(Viewer(subject, field, fit), options, scene_file)
        except BaseException as error:
            if not is_interrupt(error):
                raise


def _serve(viewer: Viewer, options: ServerOptions, scene_file: Path) -> None:
    """Serve the page until an interrupt."""
    server = PageServer(viewer, options.host, options.port)
    print(server.address, flush=True)
    say("Press Ctrl-C to stop.")
    if options.opens:
        webbrowser.open(server.address)
    try:
        with telling_untraceable(str(scene_file)):
            viewer.run()
    finally:
        server.close()


@contextmanager
def _fit(
    scene_file: Path, out: Path, views_file: Path | None, groups: str
) -> Iterator[BackgroundFit]:
    """Fit a field during the block, and keep the newest one."""
    with sole_run(out), tempfile.TemporaryDirectory(prefix="gpf-view-") as folder:
        remove_leftovers(out.parent)
        fit = BackgroundFit(scene_file, out, views_file, Path(folder), groups)
        try:
            yield fit
        finally:
            _ignore_signals()  # a second Ctrl-C would only lose the field
            kept = fit.close()
            why = f" {fit.status.error}" if fit.status.error else ""
            say(f"{out}: field after {fit.status.passes} passes" if kept else f"No field.{why}")


def _load_kept(
    out: Path, scene: mi.Scene, scene_file: Path, changed_scene: bool
) -> GaussianPhotonField:
    """The field that an earlier `gpf fit` or `gpf view` left where a new one would be written.

    Raises
    ------
    UserError: the file is not a field, or does not say that it belongs to this scene.
    """
    try:
        field = load_field(out)
        if not changed_scene and not field.record.get("fingerprint"):
            raise UserError(str(out), "does not say which scene it was fitted to", "")
        require_same_scene(scene, scene_file, field, out, changed_scene)
    except UserError as error:
        todo = "Choose another name with --output."
        if not isinstance(error, FileError):
            todo = (
                "Choose another name with --output to fit again, or view it with --changed-scene."
            )
        raise UserError(str(out), f"already exists, and {error.what}", todo) from error
    say(f"{out}: a field of this scene; to fit a new one, choose another name with --output.")
    return field


def _subject(
    scene: mi.Scene, scene_name: str, known: SceneViews, views_file: Path | None
) -> Subject:
    """The scene with cameras to jump to, with ``fov`` across x: those known, and those saved."""
    title, saved = title_of(scene_name), views_file
    sets = [known]
    if saved is None or saved.suffix == ".json":
        saved = Path(f"{title}.views.yaml")
        sets += [read_views(saved, need_training=False)] if saved.exists() else []
    cameras = [
        _across_x(view, *views.size(256))
        for views in sets
        for view in (*views.train, *views.novel, *views.more)
    ]
    return Subject(scene, title, cameras, known.aspect, known.given_exposure, saved)


def _across_x(view: View, width: int, height: int) -> View:
    """The same camera with its ``fov`` across x."""
    half = math.atan(0.5 * width / find_focal(view, (width, height)))
    return view.model_copy(update={"fov": 2 * math.degrees(half), "fov_axis": "x"})


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """SIGTERM and SIGHUP end the viewer as Ctrl-C does, so that the field is saved."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in _ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _ignore_signals() -> None:
    """Ignore the signals until the block of :func:`_ended_by_signals` ends."""
    for number in _ENDING:
        signal.signal(number, signal.SIG_IGN)
