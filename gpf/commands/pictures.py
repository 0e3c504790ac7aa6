"""The pictures of a folder: which of them are current, and how good their light is."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gpf.commands.data_set import layer_files, write_layers
from gpf.core.films import write_film
from gpf.core.images import read_exr, read_record, tone_map, write_exr, write_png
from gpf.rendering.aovs import expected_psnr
from gpf.rendering.field_renderer import describe_coverage, weakly_covered
from gpf.scene.views import View

FILM, FPS = "film.mp4", 24

WORTH_SAYING = 0.02
"""A message warns of pictures with more than this share of weakly covered pixels."""


@dataclass(frozen=True)
class Pictures:
    """Pictures in a folder, as ``NAME.exr`` and ``NAME.png``.

    Attributes
    ----------
    layers: further layers of the EXR files.
    exposure: exposure of the PNG files.
    facts: what the pictures depend on besides the exposure and their views, as JSON values.
    """

    folder: Path
    views: tuple[View, ...]
    layers: tuple[str, ...]
    exposure: float
    facts: dict[str, Any]

    def write(
        self, view: View, layers: dict[str, np.ndarray], centres: Mapping[str, np.ndarray]
    ) -> None:
        """Write the picture of a view.

        Parameters
        ----------
        layers: as rendered.
        centres: what :func:`find_layers` has found.
        """
        # Those of an earlier picture, which may have another size.
        for file in layer_files(self.folder, view).values():
            file.unlink(missing_ok=True)
        write_png(self.png(view), layers["radiance"], self.exposure)
        facts = self.record(view)
        if "error" in layers:
            facts["expected_psnr"] = expected_psnr(
                layers["radiance"], layers["error"], self.exposure
            )
        facts["weakly_covered"] = weakly_covered(layers["coverage"])
        wanted = ("radiance", *self.layers)
        write_exr(self.exr(view), {name: layers[name] for name in wanted}, facts)
        write_layers(self.folder, view, centres)

    def png(self, view: View) -> Path:
        """The picture of a view."""
        return self.folder / f"{view.name}.png"

    def exr(self, view: View) -> Path:
        """The radiance and AOVs of a view."""
        return self.folder / f"{view.name}.exr"

    def record(self, view: View) -> dict[str, Any]:
        """What the picture of a view depends on, as JSON values."""
        whole = {**self.facts, "exposure": self.exposure, "view": view.model_dump(mode="json")}
        return dict(json.loads(json.dumps(whole)))

    def is_current(self, view: View) -> bool:
        """Whether the files of a view exist and were made with these settings."""
        found = read_record(self.exr(view)) if self.png(view).exists() else None
        return found is not None and {**found, **self.record(view)} == found

    def is_another(self, view: View) -> bool:
        """Whether a file with the name of a view exists that was made in another way."""
        found = read_record(self.exr(view)) if self.exr(view).exists() else self.record(view)
        return found is None or {**found, **self.record(view)} != found

    def remarks(self) -> Iterator[str]:
        """Say how wrong the light of the pictures may be, and where it is missing."""
        records = {view.name: read_record(self.exr(view)) or {} for view in self.views}
        if any("expected_psnr" in record for record in records.values()):
            found = [r["expected_psnr"] for r in records.values() if "expected_psnr" in r]
            yield (
                f"light accurate to {np.mean(found):.1f} dB "
                f"({min(found):.1f} to {max(found):.1f}), plus noise of the camera samples"
            )
        shares = {name: record.get("weakly_covered", 0.0) for name, record in records.items()}
        if max(shares.values()) > WORTH_SAYING:
            yield f"{describe_coverage(shares)}; fit with cameras that see them"

    def write_film(self) -> None:
        """Write all pictures, in order, as an MP4."""

        def frame(view: View) -> np.ndarray:
            shown = tone_map(read_exr(self.exr(view))[0]["radiance"], self.exposure)
            return np.round(255 * shown).astype(np.uint8)

        write_film(self.folder / FILM, map(frame, self.views), FPS)
