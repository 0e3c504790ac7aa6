"""The kinds of input, and how many cases of each are run."""

from __future__ import annotations

from tests.fuzz import archives, artifacts, cameras, command_lines, fields, scenes, settings
from tests.fuzz.case import Maker

KINDS: dict[str, Maker] = {
    "scenes": scenes.make_import,
    "pictures": scenes.make_picture,
    "archives": archives.make_import,
    "cameras": cameras.make_case,
    "settings": settings.make_case,
    "fields": fields.make_case,
    "artifacts": artifacts.make_case,
    "commands": command_lines.make_case,
}
SHARES = {
    "scenes": 350,
    "pictures": 200,
    "archives": 300,
    "cameras": 300,
    "settings": 300,
    "fields": 350,
    "artifacts": 150,
    "commands": 120,
}
