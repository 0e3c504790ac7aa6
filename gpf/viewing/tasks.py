"""The files that pages wait for; each step is one frame at most."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import ValidationError

from gpf.core.errors import UserError
from gpf.scene.views import CameraPath, Keyframe, SceneViews
from gpf.viewing.downloads import Film, add_view, exr_file
from gpf.viewing.messages import GetFilm, SaveView
from gpf.viewing.page import Page
from gpf.viewing.rendering import PER_PAIR, PageRenderer, as_picture
from gpf.viewing.screen import Accumulated
from gpf.viewing.subject import Subject


def save_view(subject: Subject, page: Page, camera: Keyframe, message: SaveView) -> Iterator[None]:
    """Add a camera to the file of views."""
    taken = [known.name for known in subject.cameras]
    new = SceneViews(aspect=subject.aspect, exposure=subject.exposure or 1.0)
    view = add_view(subject.views_file, camera, message.name or "saved", taken, new)
    subject.cameras.append(view)
    page.client.tell(
        {"type": "saved", "camera": view.model_dump(), "file": subject.views_file.name}
    )
    yield


def send_exr(title: str, page: Page, picture: Accumulated) -> Iterator[None]:
    """Send a picture as an EXR."""
    if picture.frames == 0:
        raise UserError("EXR", "there is no picture of this camera yet", "Wait a moment.")
    data = exr_file(picture.mean()[..., :3], picture.frames)
    page.client.tell({"type": "file", "name": f"{title}.exr"}, data)
    yield


def send_film(renderer: PageRenderer, page: Page, message: GetFilm) -> Iterator[None]:
    """Render a film and send it."""
    subject, screens, look = renderer.subject, renderer.screens, page.look
    size = renderer.size(look, look.rows)
    path = CameraPath(keyframes=message.keyframes, frames=message.frames, closed=message.closed)
    try:
        views = SceneViews(aspect=subject.aspect, path=path, fov_axis="x").frames()
    except ValidationError as error:
        raise UserError(
            "film", error.errors()[0]["msg"], "Add keyframes between those that are far apart."
        ) from error
    with Film() as film:
        for k, view in enumerate(views):
            camera = subject.framed(view, look.aspect)
            total, field = Accumulated(), screens.field
            while total.frames < message.spp:
                total.add(screens.screen("image", size, moving=False).frame(camera))
                yield
                if screens.field is not field:  # a new one: from the start
                    total, field = Accumulated(), screens.field
            pairs = Accumulated()
            while screens.corrects and pairs.frames < message.spp // PER_PAIR:
                pairs.add(screens.gathered(camera, size))
                yield
            image, halves = total.mean(), pairs.mean() if pairs.frames else None
            if message.spp <= 16 or halves is not None:
                denoised = screens.denoised(image, halves)
                image = image if denoised is None else denoised
            film.add(renderer.display(as_picture(look), image[..., :3]))
            page.client.tell({"type": "film", "done": k + 1, "all": len(views)})
        page.client.tell({"type": "file", "name": f"{subject.title}.mp4"}, film.encode())
