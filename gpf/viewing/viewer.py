"""The viewer: renders what the open pages ask for, one frame after another."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.images import propose_exposure, read_exr, tone_map
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field
from gpf.rendering.aovs import split_layers
from gpf.rendering.denoiser import GUIDES, ImageDenoiser
from gpf.rendering.denoiser import available as has_denoiser
from gpf.rendering.lights import LightMixer
from gpf.scene.light_groups import Levels
from gpf.scene.views import CameraPath, Keyframe, SceneViews, View, name_view
from gpf.viewing.background_fit import BackgroundFit, FitStatus
from gpf.viewing.downloads import add_view, exr_file, film_file
from gpf.viewing.layers import PhotonPoints, aovs_of, as_ellipses, display
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
from gpf.viewing.screen import Accumulated, Screen, encode
from gpf.viewing.server import Client
from gpf.viewing.shown import Shown, same_place

# The camera rests if it did not move for so long; the fit goes on after the second.
_REST_SECONDS, _CALM_SECONDS = 0.12, 0.6

# Frames of a camera at rest, one sample per pixel each; without a field, passes of photons.
_FRAMES, _PASSES = 64, 200

# A picture at rest is denoised when it has so many frames, and shown until it has so many more.
_DENOISED_AT, _DENOISED_UNTIL = 8, 32

# Time between pictures of a camera at rest.
_PICTURE_SECONDS = 0.1

# Without a field: rows, and photon paths of a pass.
_PREVIEW_ROWS, _PREVIEW_PATHS = 192, 60_000

_PATH_DEPTH = 24

# Screens that are kept; each has kernels of its own.
_MOST_SCREENS = 12

# Files that a page may wait for at a time.
_MOST_TASKS = 4

# What a screen shows, its rows, and whether the camera moves.
_Key = tuple[Layer | Literal["path"], int, bool]


def _as_picture(look: Look) -> Look:
    return look.model_copy(update={"layer": "image"})


class Viewer:
    """Renders for all open pages; the thread that calls :meth:`run` does all the rendering.

    Parameters
    ----------
    title: name of the scene.
    cameras: to which pages can jump; the first is where they start. ``fov`` is that across x.
    aspect: width divided by height of all pictures.
    exposure: None to measure it in the first picture.
    scene_field: None while there is none yet.
    fit: the fit that makes fields, if one is running.
    views_file: where cameras are saved.
    references: EXR files of pictures with which those of the cameras are compared, by their names.
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
        self.scene, self.title, self.aspect = scene, title, aspect
        self.cameras, self.exposure = list(cameras), exposure
        self.field, self.fit, self.views_file = scene_field, fit, views_file
        self._pages: list[Shown] = []
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._screens: OrderedDict[_Key, Screen] = OrderedDict()
        self._paces: dict[Layer, Pace] = {}
        self._ellipses: GaussianPhotonField | None = None
        self._photons: PhotonPoints | None = None
        self._denoisers: dict[tuple[int, int], ImageDenoiser] = {}
        self._references = {
            name: read_exr(file)[0]["radiance"] for name, file in (references or {}).items()
        }
        self._status = FitStatus()
        self._seed = 0
        self._levels: Levels | None = None  # to be set
        self._mixer: LightMixer | None = None
        self._mix()

    # What the server calls, from its own threads.

    def opened(self, client: Client) -> None:
        """A page was opened: tell it what there is."""
        client.tell(
            {
                "type": "hello",
                "title": self.title,
                "aspect": self.aspect,
                "cameras": [camera.model_dump() for camera in self.cameras],
                "reference_rows": max((len(r) for r in self._references.values()), default=0),
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
                if isinstance(message, SaveView):
                    page.tasks.append(self._save_view(page, message))
                elif isinstance(message, GetFile):
                    page.tasks.append(self._send_exr(page))
                elif isinstance(message, GetFilm):
                    page.tasks.append(self._send_film(page, message))
        self._wake.set()

    # The thread that renders.

    def run(self) -> None:
        """Render until Ctrl-C."""
        while True:
            if not self.step():
                self._wake.wait(0.05)
                self._wake.clear()

    def step(self) -> bool:
        """Take a new field, and render a frame; whether there was something to render."""
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

    def _mix(self) -> None:
        """Take the groups of lights of a new field, at the levels of the one before."""
        levels = self._mixer.levels if self._mixer is not None else {}
        if self._mixer is not None:
            self._mixer.set({})  # the emitters as they were
        has_lights = self.field is not None and self.field.lights is not None
        self._mixer = LightMixer(self.scene, self.field) if has_lights and self.field else None
        if self._mixer is not None and levels:
            self._mixer.set(levels)

    def _follow_fit(self) -> None:
        """Tell the pages how far the fit is, and take its newest field."""
        if self.fit is None or self.fit.status == self._status:
            return
        before, self._status = self._status, self.fit.status
        if self._status.fields > before.fields:
            if self.field is None:
                self._screens.clear()  # they show photon mapping
            self.field, self._ellipses = load_field(self.fit.live), None
            self._mix()
            for (layer, *_), screen in self._screens.items():
                if layer != "path":
                    screen.integrator.field = self._field_of(layer)
            with self._lock:
                for page in self._pages:
                    page.start_anew()
        with self._lock:
            pages = list(self._pages)
        for page in pages:
            page.client.tell(self._status_message())

    def _set_lights(self) -> None:
        """Set the levels that a page has asked for."""
        with self._lock:
            levels, self._levels = self._levels, None
        if levels is None or self._mixer is None:
            return
        try:
            known = {name: level for name, level in levels.items() if name in self._mixer.names}
            self._mixer.set(known)
        except UserError as error:
            with self._lock:
                for page in self._pages:
                    page.client.tell({"type": "error", "text": str(error)})
            return
        self._ellipses = None
        for (layer, *_), screen in self._screens.items():
            if layer == "gaussians":
                screen.integrator.field = self._field_of(layer)
        with self._lock:
            for page in self._pages:
                page.moving = True

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
            "lights": list(self._mixer.names) if self._mixer else [],
            "has_error": self.field is not None and self.field.error is not None,
            "error": status.error,
        }

    def _size(self, height: int) -> tuple[int, int]:
        return max(1, round(height * self.aspect)), height

    def _layer(self, look: Look) -> Layer:
        """The layer that a page looks at; the picture, if the field does not have it."""
        if look.layer == "photons":
            return "photons"
        lacks_error = look.layer == "error" and (self.field is None or self.field.error is None)
        return "image" if self.field is None or lacks_error else look.layer

    def _field_of(self, layer: Layer) -> GaussianPhotonField | None:
        if layer != "gaussians" or self.field is None:
            return self.field
        self._ellipses = self._ellipses or as_ellipses(self.field)
        return self._ellipses

    def _screen(self, layer: Layer, height: int, moving: bool) -> Screen:
        """The screen for a layer; made at its first use."""
        guides = not moving and has_denoiser()
        key: _Key = (layer, height, moving)
        if key not in self._screens:
            if self.field is None:
                integrator = mi.load_dict({"type": "sppm", "photons_per_pass": _PREVIEW_PATHS})
            else:
                integrator = mi.load_dict(
                    {
                        "type": "gpf",
                        "record": True,
                        "aovs": aovs_of(layer, guides),
                        "glossy_walks": 1 if moving else 4,
                    }
                )
                integrator.field = self._field_of(layer)
            self._screens[key] = Screen(self.scene, integrator, self._size(height))
            while len(self._screens) > _MOST_SCREENS:
                self._screens.popitem(last=False)
        self._screens.move_to_end(key)
        return self._screens[key]

    def _next_seed(self) -> int:
        self._seed = (self._seed + 1) % (1 << 30)
        return self._seed

    def _show_moving(self, page: Shown) -> None:
        """One picture of a moving camera."""
        with self._lock:
            look, camera, number = page.look, page.camera, page.number
            page.moving = False
        layer = self._layer(look)
        page.start_anew()
        pace = self._paces.setdefault(layer, Pace())
        start = time.perf_counter()
        if layer == "photons":
            self._show_photons(page)
            return
        height = _PREVIEW_ROWS if self.field is None else pace.height(self.aspect, look.rows)
        screen = self._screen(layer, height, moving=True)
        image = screen.frame(camera, self._next_seed())
        self._send(page, self._display(look, image), number, 1, 80)
        if screen.frames > 3:  # the first ones record
            pace.note(time.perf_counter() - start, screen.size[0] * screen.size[1])

    def _show_photons(self, page: Shown) -> None:
        if self._photons is None:
            self._photons = PhotonPoints(self.scene)
        pixels = self._photons.draw(page.camera, self._size(page.look.rows))
        self._send(page, pixels, page.number, 1, 90)

    def _display(self, look: Look, image: np.ndarray) -> np.ndarray:
        if self.exposure is None:
            self.exposure = propose_exposure(image[..., :3])
        return display(self._layer(look), image, self.exposure * 2.0**look.stops, look.curve)

    def _go_on(self, page: Shown) -> bool:
        """One more frame of a camera at rest, or one more step of a task; whether there was one."""
        if self._do_task(page):
            return True
        look = page.look
        if look.layer == "photons" or not page.client.waits:
            return False
        most = _PASSES if self.field is None else _FRAMES
        compares = look.compare == "path" and page.compared_seconds < page.seconds
        if page.picture.frames >= most and not compares:
            return False
        height = _PREVIEW_ROWS if self.field is None else look.rows
        number, start = page.number, time.perf_counter()
        if page.has_moved():
            return True
        if compares:
            screen = self._path_screen(height)
            page.compared.add(screen.frame(page.camera, self._next_seed()))
            page.compared_seconds += time.perf_counter() - start
        else:
            screen = self._screen(self._layer(look), height, moving=False)
            page.picture.add(screen.frame(page.camera, self._next_seed()))
            page.seconds += time.perf_counter() - start
        if page.has_moved():
            return True  # the camera has moved meanwhile
        ended = page.picture.frames >= most
        if page.picture.frames and (
            ended or compares or time.perf_counter() - page.sent > _PICTURE_SECONDS
        ):
            self._show_resting(page, number)
        return True

    def _show_resting(self, page: Shown, number: int) -> None:
        """The mean of all frames so far; with few of them, denoised."""
        look, frames = page.look, page.picture.frames
        image = page.picture.mean()
        if self.field is not None and look.layer == "image" and not look.compare:
            if frames >= _DENOISED_AT and page.denoised is None and has_denoiser():
                page.denoised = self._denoise(image)
            if page.denoised is not None and frames < _DENOISED_UNTIL:
                image = page.denoised
        psnr = self._psnr(page.camera, image) if look.layer == "image" else None
        self._send(page, self._display(look, image), number, frames, 92, psnr=psnr)
        beside = self._reference(page.camera) if look.compare == "reference" else None
        if look.compare == "path" and page.compared.frames:
            beside = page.compared.mean()
        if beside is not None:
            other = self._display(_as_picture(look), beside)
            self._send(page, other, number, page.compared.frames, 92, role="compare")

    def _reference(self, camera: Keyframe) -> np.ndarray | None:
        """The reference of a camera, (H, W, 3), if there is one."""
        found = (known.name for known in self.cameras if same_place(known, camera))
        return next((self._references[name] for name in found if name in self._references), None)

    def _psnr(self, camera: Keyframe, image: np.ndarray) -> float | None:
        """The PSNR of a picture against the reference of its camera, dB; None without one."""
        reference = self._reference(camera)
        if reference is None or self.exposure is None or reference.shape[:2] != image.shape[:2]:
            return None
        shown = (tone_map(i, self.exposure) for i in (reference, image[..., :3]))
        return float(-10 * np.log10(max(np.mean(np.square(np.subtract(*shown))), 1e-10)))

    def _denoise(self, image: np.ndarray) -> np.ndarray:
        layers = split_layers(image, GUIDES)
        size = image.shape[1], image.shape[0]
        if size not in self._denoisers:
            self._denoisers = {size: ImageDenoiser(size, prefilter=True, quality="fast")}
        return self._denoisers[size].denoise(layers["radiance"], *(layers[g] for g in GUIDES))

    def _path_screen(self, height: int) -> Screen:
        key: _Key = ("path", height, False)
        if key not in self._screens:
            integrator = mi.load_dict({"type": "path", "max_depth": _PATH_DEPTH})
            self._screens[key] = Screen(self.scene, integrator, self._size(height))
        return self._screens[key]

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

    def _save_view(self, page: Shown, message: SaveView) -> Iterator[None]:
        taken = {camera.name for camera in self.cameras}
        name = name_view(message.name or "saved", taken, otherwise="saved")
        view = View(**page.camera.model_dump(), name=name)
        new = SceneViews(aspect=self.aspect, exposure=self.exposure or 1.0)
        add_view(self.views_file, view, new)
        self.cameras.append(view)
        page.client.tell({"type": "saved", "camera": view.model_dump()})
        yield

    def _send_exr(self, page: Shown) -> Iterator[None]:
        frames = page.picture.frames
        if frames:
            data = exr_file(page.picture.mean()[..., :3], frames)
            page.client.tell({"type": "file", "name": f"{self.title}.exr"}, data)
        yield

    def _send_film(self, page: Shown, message: GetFilm) -> Iterator[None]:
        path = CameraPath(keyframes=message.keyframes, frames=message.frames, closed=message.closed)
        views = SceneViews(aspect=self.aspect, path=path, fov_axis="x").frames()
        look, pictures = page.look, []
        for k, view in enumerate(views):
            total = Accumulated()
            for _ in range(message.spp):
                screen = self._screen("image", look.rows, moving=False)
                total.add(screen.frame(view, self._next_seed()))
                yield
            image = total.mean()
            if self.field is not None and message.spp <= 16 and has_denoiser():
                image = self._denoise(image)
            pictures.append(self._display(_as_picture(look), image[..., :3]))
            page.client.tell({"type": "film", "done": k + 1, "all": len(views)})
        page.client.tell({"type": "file", "name": f"{self.title}.mp4"}, film_file(pictures))
