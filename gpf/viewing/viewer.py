"""The viewer: renders what the open pages ask for, one frame after another."""

from __future__ import annotations

import threading
import time
from typing import Any

from gpf.core.errors import UserError
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field
from gpf.scene.light_groups import Levels
from gpf.scene.views import Keyframe
from gpf.viewing.background_fit import BackgroundFit, FitStatus
from gpf.viewing.messages import Camera, GetFile, GetFilm, Lights, Look, Message, SaveView
from gpf.viewing.page import Page
from gpf.viewing.rendering import PageRenderer
from gpf.viewing.server import Client
from gpf.viewing.subject import Subject
from gpf.viewing.tasks import save_view, send_exr, send_film

# Time without movement after which the camera is at rest, and after which the fit continues.
_REST_SECONDS, _CALM_SECONDS = 0.12, 0.6

# Time between error messages.
_ERROR_SECONDS = 1.0

# Files that a page may wait for at once.
_MOST_TASKS = 4


class Viewer:
    """Renders for all open pages; the thread that calls :meth:`run` does all the rendering.

    Parameters
    ----------
    scene_field: None while there is none yet.
    fit: the fit that makes fields, if one is running.
    """

    def __init__(
        self,
        subject: Subject,
        scene_field: GaussianPhotonField | None,
        fit: BackgroundFit | None = None,
    ) -> None:
        self.subject, self.fit = subject, fit
        self.renderer = PageRenderer(subject, scene_field)
        self._pages: list[Page] = []
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._status = FitStatus()
        self._levels: Levels | None = None  # to be set

    @property
    def field(self) -> GaussianPhotonField | None:
        """The field that is shown; None while there is none yet."""
        return self.renderer.screens.field

    # What the server calls, from its own threads.

    def opened(self, client: Client) -> None:
        """A page was opened: tell it what there is."""
        subject = self.subject
        client.tell(
            {
                "type": "hello",
                "title": subject.title,
                "aspect": subject.aspect,
                "cameras": [camera.model_dump() for camera in subject.cameras],
                "reference_rows": subject.references.rows,
            }
        )
        client.tell(self._status_message())
        with self._lock:
            start = Keyframe(**subject.cameras[0].model_dump(exclude={"name", "fov_axis"}))
            self._pages.append(Page(client, start))
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
                    page.tasks.append(save_view(self.subject, page, page.camera, message))
                elif isinstance(message, GetFile):
                    page.tasks.append(send_exr(self.subject.title, page, page.picture))
                elif isinstance(message, GetFilm):
                    page.tasks.append(send_film(self.renderer, page, message))
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
                with self._lock:
                    asked = page.look, page.camera, page.number
                    page.moving = False
                self.renderer.show_moving(page, *asked)
                return True
        rests = [page for page in pages if now - page.moved > _REST_SECONDS]
        return any(page.do_task() or self.renderer.refine(page) for page in rests)

    def _follow_fit(self) -> None:
        """Tell the pages about the fit's progress, and take its newest field."""
        if self.fit is None or self.fit.status == self._status:
            return
        before, self._status = self._status, self.fit.status
        if self._status.fields > before.fields:
            self.renderer.screens.take(load_field(self.fit.live))
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
            self.renderer.screens.set_lights(levels)
        except UserError as error:
            self._tell_all({"type": "error", "text": str(error)})
            return
        with self._lock:
            for page in self._pages:
                page.moving = True
        self._tell_all(self._status_message())

    def _status_message(self) -> dict[str, Any]:
        status, field = self._status, self.field
        record = field.record if field is not None else {}
        return {
            "type": "status",
            "fits": self.fit is not None and not status.ended,
            "passes": status.passes if self.fit else record.get("passes"),
            "all_passes": status.all_passes if self.fit else record.get("passes"),
            "psnr": status.psnr if self.fit else record.get("estimated_psnr"),
            "has_field": field is not None,
            "lights": self.renderer.screens.lights,
            "has_error": field is not None and field.error is not None,
            "error": status.error,
        }
