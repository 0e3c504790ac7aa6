"""The viewer: renders what the open pages ask for, one frame after another."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from pydantic import ValidationError

from gpf.core.errors import UserError
from gpf.core.images import propose_exposure
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field
from gpf.scene.light_groups import Levels
from gpf.scene.views import CameraPath, Keyframe, SceneViews, View
from gpf.viewing.background_fit import BackgroundFit, FitStatus
from gpf.viewing.downloads import Film, add_view, exr_file
from gpf.viewing.layers import display
from gpf.viewing.messages import (
    Camera,
    GetFile,
    GetFilm,
    Layer,
    Lights,
    Look,
    Message,
    SaveView,
)
from gpf.viewing.pace import Pace
from gpf.viewing.references import References
from gpf.viewing.screen import Accumulated, encode
from gpf.viewing.screens import Screens
from gpf.viewing.server import Client
from gpf.viewing.shown import Shown

# Time without movement after which the camera is at rest, and after which the fit continues.
_REST_SECONDS, _CALM_SECONDS = 0.12, 0.6

# Frames of a camera at rest, one sample per pixel each; without a field, passes of photons.
_FRAMES, _PASSES = 64, 200

# A picture at rest is denoised when it has this many frames; the result is shown until there are
# this many.
_DENOISED_AT, _DENOISED_UNTIL = 8, 32

# Time between pictures of a camera at rest.
_PICTURE_SECONDS = 0.1

# Time between error messages.
_ERROR_SECONDS = 1.0

# Rows of pictures while there is no field.
_PREVIEW_ROWS = 192

# Files that a page may wait for at once.
_MOST_TASKS = 4


def _as_picture(look: Look) -> Look:
    return look.model_copy(update={"layer": "image"})


class Viewer:
    """Renders for all open pages; the thread that calls :meth:`run` does all the rendering.

    Parameters
    ----------
    title: name of the scene.
    cameras: cameras that pages can jump to, with ``fov`` across x; they start at the first.
    aspect: width divided by height of all pictures.
    exposure: None to measure it in the first picture.
    scene_field: None while there is none yet.
    fit: the fit that makes fields, if one is running.
    views_file: where cameras are saved.
    references: EXR files of the cameras' references, by camera name.
    """

    def __init__(
        self,
        scene: mi.Scene,
        title: str,
        cameras: Sequence[View],
        aspect: float,
        exposure: float | None,
        scene_field: GaussianPhotonField | None,
        fit: BackgroundFit | None,
        views_file: Path,
        references: Mapping[str, Path] | None = None,
    ) -> None:
        self.title, self.aspect = title, aspect
        self.cameras, self.exposure = list(cameras), exposure
        self.fit, self.views_file = fit, views_file
        self.screens = Screens(scene, aspect, scene_field)
        self.references = References(self.cameras, references or {})
        self._pages: list[Shown] = []
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._paces: dict[Layer, Pace] = {}
        self._status = FitStatus()
        self._levels: Levels | None = None  # to be set

    @property
    def field(self) -> GaussianPhotonField | None:
        """The field that is shown; None while there is none yet."""
        return self.screens.field

    # What the server calls, from its own threads.

    def opened(self, client: Client) -> None:
        """A page was opened: tell it what there is."""
        client.tell(
            {
                "type": "hello",
                "title": self.title,
                "aspect": self.aspect,
                "cameras": [camera.model_dump() for camera in self.cameras],
                "reference_rows": self.references.rows,
            }
        )
        client.tell(self._status_message())
        with self._lock:
            start = Keyframe(**self.cameras[0].model_dump(exclude={"name", "fov_axis"}))
            self._pages.append(Shown(client, start))
        self._wake.set()

    def closed(self, client: Client) -> None:
        """A page was closed."""
        with self._lock:
            self._pages = [page for page in self._pages if page.client is not client]

    def received(self, client: Client, message: Message) -> None:
        """A page has sent a message."""
        with self._lock:
            page = next((p for p in self._pages if p.client is client), None)
            if page is None:
                return
            if isinstance(message, Camera):
                page.camera, page.number = message.camera, message.number
                page.moved, page.moving = time.perf_counter(), True
            elif isinstance(message, Lights):
                self._levels, page.number = message.levels, message.number
            elif isinstance(message, Look):
                page.look, page.number, page.moving = message, message.number, True
            elif len(page.tasks) < _MOST_TASKS:
                # The camera and picture of this moment: the page may move before the task runs.
                if isinstance(message, SaveView):
                    page.tasks.append(self._save_view(page, page.camera, message))
                elif isinstance(message, GetFile):
                    page.tasks.append(self._send_exr(page, page.picture))
                elif isinstance(message, GetFilm):
                    page.tasks.append(self._send_film(page, message))
        self._wake.set()

    # The thread that renders.

    def run(self) -> None:
        """Render until Ctrl-C. Errors are sent to the pages."""
        while True:
            pause = 0.05
            try:
                if self.step():
                    continue
            except UserError as error:
                self._tell_all({"type": "error", "text": str(error)})
                pause = _ERROR_SECONDS
            self._wake.wait(pause)
            self._wake.clear()

    def step(self) -> bool:
        """Take a new field and render a frame; return whether there was something to render."""
        self._follow_fit()
        self._set_lights()
        with self._lock:
            pages = sorted(self._pages, key=lambda page: page.sent)
        now = time.perf_counter()
        if self.fit is not None:
            # Until there is a field, the fit has one of the two cores.
            moves = any(now - page.moved < _CALM_SECONDS for page in pages)
            self.fit.pause(moves and self.field is not None)
        for page in pages:
            if page.moving and page.client.waits:
                self._show_moving(page)
                return True
        rests = [page for page in pages if now - page.moved > _REST_SECONDS]
        return any(self._go_on(page) for page in rests)

    def _follow_fit(self) -> None:
        """Tell the pages about the fit's progress, and take its newest field."""
        if self.fit is None or self.fit.status == self._status:
            return
        before, self._status = self._status, self.fit.status
        if self._status.fields > before.fields:
            self.screens.take(load_field(self.fit.live))
            with self._lock:
                for page in self._pages:
                    page.start_anew()
        self._tell_all(self._status_message())

    def _tell_all(self, message: dict[str, Any]) -> None:
        with self._lock:
            for page in self._pages:
                page.client.tell(message)

    def _set_lights(self) -> None:
        """Set the levels that a page has asked for."""
        with self._lock:
            levels, self._levels = self._levels, None
        if levels is None:
            return
        try:
            self.screens.set_lights(levels)
        except UserError as error:
            self._tell_all({"type": "error", "text": str(error)})
            return
        with self._lock:
            for page in self._pages:
                page.moving = True
        self._tell_all(self._status_message())

    def _status_message(self) -> dict[str, Any]:
        status = self._status
        record = self.field.record if self.field is not None else {}
        return {
            "type": "status",
            "fits": self.fit is not None and not status.ended,
            "passes": status.passes if self.fit else record.get("passes"),
            "all_passes": status.all_passes if self.fit else record.get("passes"),
            "psnr": status.psnr if self.fit else record.get("estimated_psnr"),
            "has_field": self.field is not None,
            "lights": self.screens.lights,
            "has_error": self.field is not None and self.field.error is not None,
            "error": status.error,
        }

    def _show_moving(self, page: Shown) -> None:
        """Show one picture of a moving camera."""
        with self._lock:
            look, camera, number = page.look, page.camera, page.number
            page.moving = False
        layer = self.screens.layer(look.layer)
        page.start_anew()
        if layer == "photons":
            self._send(page, self.screens.photons(camera, look.rows), number, 1, 90)
            return
        pace = self._paces.setdefault(layer, Pace())
        start = time.perf_counter()
        rows = _PREVIEW_ROWS if self.field is None else pace.height(self.aspect, look.rows)
        screen = self.screens.screen(layer, rows, moving=True)
        image = screen.frame(camera)
        self._send(page, self._display(look, image), number, 1, 80)
        if screen.frames > 3:  # the first ones record
            pace.note(time.perf_counter() - start, screen.size[0] * screen.size[1])

    def _display(self, look: Look, image: np.ndarray) -> np.ndarray:
        if self.exposure is None:
            self.exposure = propose_exposure(image[..., :3])
        return display(
            self.screens.layer(look.layer), image, self.exposure * 2.0**look.stops, look.curve
        )

    def _go_on(self, page: Shown) -> bool:
        """Do one more step of a task or render one more frame of a camera at rest; return whether
        there was one."""
        if self._do_task(page):
            return True
        look = page.look
        if look.layer == "photons" or not page.client.waits:
            return False
        most = _PASSES if self.field is None else _FRAMES
        compares = look.compare == "path" and page.compared_seconds < page.seconds
        if page.picture.frames >= most and not compares:
            return False
        rows = _PREVIEW_ROWS if self.field is None else look.rows
        number, start = page.number, time.perf_counter()
        if page.has_moved():
            return True
        if compares:
            page.compared.add(self.screens.path_screen(rows).frame(page.camera))
            page.compared_seconds += time.perf_counter() - start
        else:
            screen = self.screens.screen(self.screens.layer(look.layer), rows, moving=False)
            page.picture.add(screen.frame(page.camera))
            page.seconds += time.perf_counter() - start
        if page.has_moved():
            return True  # the camera has moved in the meantime
        ended = page.picture.frames >= most
        if page.picture.frames and (
            ended or compares or time.perf_counter() - page.sent > _PICTURE_SECONDS
        ):
            self._show_resting(page, number)
        return True

    def _show_resting(self, page: Shown, number: int) -> None:
        """Show the mean of all frames so far, denoised if there are few of them."""
        look, frames = page.look, page.picture.frames
        image = page.picture.mean()
        if look.layer == "image" and not look.compare:
            if frames >= _DENOISED_AT and page.denoised is None:
                page.denoised = self.screens.denoised(image)
            if page.denoised is not None and frames < _DENOISED_UNTIL:
                image = page.denoised
        pixels, psnr = self._display(look, image), None
        if look.layer == "image" and self.exposure is not None and not self.screens.dimmed:
            psnr = self.references.psnr(page.camera, image, self.exposure)
        self._send(page, pixels, number, frames, 92, psnr=psnr)
        beside = None
        if look.compare == "reference" and not self.screens.dimmed:
            beside = self.references.of(page.camera)
        if look.compare == "path" and page.compared.frames:
            beside = page.compared.mean()
        if beside is not None:
            other = self._display(_as_picture(look), beside)
            self._send(page, other, number, page.compared.frames, 92, role="compare")

    def _send(
        self,
        page: Shown,
        pixels: np.ndarray,
        number: int,
        frames: int,
        quality: int,
        role: str = "picture",
        psnr: float | None = None,
    ) -> None:
        header = {
            "number": number,
            "frames": frames,
            "width": pixels.shape[1],
            "height": pixels.shape[0],
            "role": role,
            "psnr": psnr,
            "passes": self.field is None,
        }
        page.client.show(header, encode(pixels, quality))
        page.sent = time.perf_counter()

    # Tasks: each step is one frame at most, so that cameras keep moving.

    def _do_task(self, page: Shown) -> bool:
        if not page.tasks:
            return False
        try:
            next(page.tasks[0])
        except StopIteration:
            page.tasks.popleft()
        except UserError as error:
            page.tasks.popleft()
            page.client.tell({"type": "error", "text": str(error)})
        return True

    def _save_view(self, page: Shown, camera: Keyframe, message: SaveView) -> Iterator[None]:
        taken = [camera.name for camera in self.cameras]
        new = SceneViews(aspect=self.aspect, exposure=self.exposure or 1.0)
        view = add_view(self.views_file, camera, message.name or "saved", taken, new)
        self.cameras.append(view)
        page.client.tell({"type": "saved", "camera": view.model_dump()})
        yield

    def _send_exr(self, page: Shown, picture: Accumulated) -> Iterator[None]:
        if picture.frames == 0:
            raise UserError("EXR", "there is no picture of this camera yet", "Wait a moment.")
        data = exr_file(picture.mean()[..., :3], picture.frames)
        page.client.tell({"type": "file", "name": f"{self.title}.exr"}, data)
        yield

    def _send_film(self, page: Shown, message: GetFilm) -> Iterator[None]:
        path = CameraPath(keyframes=message.keyframes, frames=message.frames, closed=message.closed)
        try:
            views = SceneViews(aspect=self.aspect, path=path, fov_axis="x").frames()
        except ValidationError as error:
            raise UserError(
                "film", error.errors()[0]["msg"], "Add keyframes between those that are far apart."
            ) from error
        look = page.look
        with Film() as film:
            for k, view in enumerate(views):
                total = Accumulated()
                for _ in range(message.spp):
                    total.add(self.screens.screen("image", look.rows, moving=False).frame(view))
                    yield
                image = total.mean()
                if message.spp <= 16:
                    denoised = self.screens.denoised(image)
                    image = image if denoised is None else denoised
                film.add(self._display(_as_picture(look), image[..., :3]))
                page.client.tell({"type": "film", "done": k + 1, "all": len(views)})
            page.client.tell({"type": "file", "name": f"{self.title}.mp4"}, film.encode())
