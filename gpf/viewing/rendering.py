"""The pictures of a page: of a moving camera, and ever better ones of a camera at rest."""

from __future__ import annotations

import time

import numpy as np

from gpf.core.images import propose_exposure
from gpf.field.field import GaussianPhotonField
from gpf.scene.views import Keyframe
from gpf.viewing.layers import display
from gpf.viewing.messages import Layer, Look
from gpf.viewing.pace import Pace
from gpf.viewing.page import Page
from gpf.viewing.screen import Screen, encode
from gpf.viewing.screens import Screens
from gpf.viewing.subject import Subject

# Frames of a camera at rest, one sample per pixel each; without a field, passes of photons.
_FRAMES, _PASSES = 64, 200

# A picture at rest is denoised when it has this many frames; the result is shown until there are
# this many.
_DENOISED_AT, _DENOISED_UNTIL = 8, 32

PER_PAIR = 8
"""Frames of the field for each pair with gathered light, which corrects the denoised picture."""

# Time between pictures of a camera at rest.
_PICTURE_SECONDS = 0.1

# Rows of pictures while there is no field.
_PREVIEW_ROWS = 192


def _timed(screen: Screen, camera: Keyframe) -> tuple[np.ndarray, float]:
    """A frame, and the seconds that it took."""
    start = time.perf_counter()
    return screen.frame(camera), time.perf_counter() - start


def as_picture(look: Look) -> Look:
    """The same look at the picture itself."""
    return look.model_copy(update={"layer": "image"})


class PageRenderer:
    """Renders the pictures of all pages.

    Parameters
    ----------
    field: None while there is none yet.
    """

    def __init__(self, subject: Subject, field: GaussianPhotonField | None) -> None:
        self.subject = subject
        self.screens = Screens(subject.scene, field)
        self._paces: dict[Layer, Pace] = {}

    def show_moving(self, page: Page, look: Look, camera: Keyframe, number: int) -> None:
        """Show one picture of a moving camera; ``number`` is that of the message that asks."""
        layer = self.screens.layer(look.layer)
        page.start_anew()
        if layer == "photons":
            framed = self.subject.framed(camera, look.aspect)
            self._send(
                page, self.screens.photons(framed, self.size(look, look.rows)), number, 1, 90
            )
            return
        pace = self._paces.setdefault(layer, Pace())
        start = time.perf_counter()
        rows = _PREVIEW_ROWS
        if self.screens.field is not None:
            rows = pace.height(look.aspect or self.subject.aspect, look.rows)
        screen = self.screens.screen(layer, self.size(look, rows), moving=True)
        image = screen.frame(self.subject.framed(camera, look.aspect))
        self._send(page, self.display(look, image), number, 1, 80)
        if screen.frames > 3:  # the first ones record
            pace.note(time.perf_counter() - start, screen.size[0] * screen.size[1])

    def refine(self, page: Page) -> bool:
        """Render one more frame of a camera at rest; return whether there was one to render."""
        look, picture = page.look, page.picture
        if look.layer == "photons" or not page.client.waits:
            return False
        most, rows = _FRAMES, look.rows
        if self.screens.field is None:
            most, rows = _PASSES, _PREVIEW_ROWS
        compares = look.compare == "path" and page.compared.seconds < picture.seconds
        gathers = self._gathers(page)
        if picture.frames >= most and not compares and not gathers:
            return False
        number = page.number
        if page.has_moved():
            return True
        camera, size = self.subject.framed(page.camera, look.aspect), self.size(look, rows)
        if gathers:
            page.gathered.add(self.screens.gathered(camera, size))
            if page.gathered.frames.bit_count() == 1:
                page.denoised = None  # when there are twice as many, it is corrected again
        elif compares:
            page.compared.add(*_timed(self.screens.path_screen(size), camera))
        else:
            screen = self.screens.screen(self.screens.layer(look.layer), size, moving=False)
            picture.add(*_timed(screen, camera))
            if page.depth is None:
                page.depth = screen.depth()
        if page.has_moved():
            return True  # the camera has moved in the meantime
        due = time.perf_counter() - page.sent > _PICTURE_SECONDS
        if picture.frames and (picture.frames >= most or compares or due):
            self._show_resting(page, number)
        return True

    def _gathers(self, page: Page) -> bool:
        """Whether a pair of pictures with gathered light comes next."""
        pairs = page.picture.frames // PER_PAIR
        shown = page.look.layer == "image" and not page.look.compare
        return shown and self.screens.corrects and page.gathered.frames < pairs

    def size(self, look: Look, rows: int) -> tuple[int, int]:
        """Width and height of a picture, pixels."""
        return max(1, round(rows * (look.aspect or self.subject.aspect))), rows

    def display(self, look: Look, image: np.ndarray) -> np.ndarray:
        """Display values (H, W, 3) uint8 of an image (H, W, C)."""
        if self.subject.exposure is None:
            self.subject.exposure = propose_exposure(image[..., :3])
        exposure = self.subject.exposure * 2.0**look.stops
        return display(self.screens.layer(look.layer), image, exposure, look.curve)

    def _show_resting(self, page: Page, number: int) -> None:
        """Show the mean of all frames so far, denoised if there are few of them, or if it is
        corrected."""
        look, frames = page.look, page.picture.frames
        image = page.picture.mean()
        if look.layer == "image" and not look.compare:
            if frames >= _DENOISED_AT and page.denoised is None:
                halves = page.gathered.mean() if page.gathered.frames else None
                page.denoised = self.screens.denoised(image, halves)
            if page.denoised is not None and (frames < _DENOISED_UNTIL or page.gathered.frames):
                image = page.denoised
        pixels, psnr = self.display(look, image), None
        exposure, references = self.subject.exposure, self.subject.references
        if look.layer == "image" and exposure is not None and not self.screens.dimmed:
            psnr = references.psnr(page.camera, image, exposure)
        self._send(page, pixels, number, frames, 92, psnr=psnr)
        beside = None
        if look.compare == "reference" and not self.screens.dimmed:
            beside = references.of(page.camera)
        if look.compare == "path" and page.compared.frames:
            beside = page.compared.mean()
        if beside is not None:
            other = self.display(as_picture(look), beside)
            self._send(page, other, number, page.compared.frames, 92, role="compare")

    def _send(
        self,
        page: Page,
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
            "depth": page.depth,
            "passes": self.screens.field is None,
        }
        page.client.show(header, encode(pixels, quality))
        page.sent = time.perf_counter()
