"""The messages between the page and the server.

The page sends JSON texts, each one of the classes below. The server answers with binary messages:
the length of a JSON header as four bytes (big endian), the header, and then a picture or a file.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from gpf.core.errors import UserError
from gpf.core.settings import Count, Settings
from gpf.scene.light_groups import MOST_GROUPS
from gpf.scene.views import Keyframe

MOST_BYTES = 1 << 16
"""Size of the largest message that a page may send."""

MOST_ROWS = 2160

Layer = Literal[
    "image", "irradiance", "albedo", "normal", "depth", "coverage", "error", "gaussians", "photons"
]


class Camera(Settings):
    """The camera moved. ``number`` counts these messages and those of :class:`Look`; each picture
    carries the number of the newest message that it shows."""

    type: Literal["camera"] = "camera"
    camera: Keyframe
    number: Count


class Look(Settings):
    """What the page shows, and how.

    Attributes
    ----------
    rows: height of the picture of a camera at rest, pixels.
    aspect: width divided by height of the pictures; None for that of the scene's cameras.
    layer: the picture, a layer of it in false colours, or the Gaussians or photons themselves.
    stops: exposure in powers of two, relative to that of the scene.
    curve: ``srgb`` clips bright light; ``soft`` never does.
    compare: what is shown beside it, if anything: ``path`` for path tracing with as much time, or
        the camera's reference.
    number: see :class:`Camera`.
    """

    type: Literal["look"] = "look"
    number: Annotated[int, Field(ge=0)] = 0
    rows: Annotated[int, Field(ge=64, le=MOST_ROWS)] = 384
    aspect: Annotated[float, Field(ge=0.2, le=5)] | None = None
    layer: Layer = "image"
    stops: Annotated[float, Field(ge=-20, le=20)] = 0.0
    curve: Literal["srgb", "soft"] = "srgb"
    compare: Literal["", "path", "reference"] = ""


Factor = Annotated[float, Field(ge=0, le=1000)]


class Lights(Settings):
    """Levels of groups of emitters: factors of red, green and blue."""

    type: Literal["lights"] = "lights"
    number: Count
    levels: Annotated[dict[str, tuple[Factor, Factor, Factor]], Field(max_length=MOST_GROUPS)]


class Seen(Settings):
    """The page has shown this picture, and is ready for the next."""

    type: Literal["seen"] = "seen"
    picture: Count


class SaveView(Settings):
    """Add the camera to the file of views."""

    type: Literal["save_view"] = "save_view"
    name: Annotated[str, Field(max_length=60)] = ""


class GetFile(Settings):
    """Send the current picture as an EXR."""

    type: Literal["exr"] = "exr"


class GetFilm(Settings):
    """Send a film through keyframes."""

    type: Literal["film"] = "film"
    keyframes: Annotated[tuple[Keyframe, ...], Field(min_length=2, max_length=64)]
    frames: Annotated[int, Field(ge=2, le=600)] = 72
    spp: Annotated[int, Field(ge=1, le=256)] = 8
    closed: bool = False


Message = Camera | Look | Lights | Seen | SaveView | GetFile | GetFilm

_ANY: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="type")])


def read_message(text: str | bytes) -> Message:
    """The message in a text.

    Raises
    ------
    UserError: it is not JSON, its type is unknown, or a value is wrong.
    """
    try:
        return _ANY.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_input=False, include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise UserError(f"message: {where}", first["msg"], "Reload the page.") from error


def pack(header: Mapping[str, Any], data: bytes = b"") -> bytes:
    """A message for the page."""
    text = json.dumps(header).encode()
    return struct.pack(">I", len(text)) + text + data
