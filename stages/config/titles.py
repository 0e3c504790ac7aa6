"""Titles of methods, references and variants in tables and figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from baselines.options import BaselineOptions
from gpf.sppm.reference import ReferenceSettings
from stages.config.params import Params
from stages.config.pipeline import OWN_METHODS, Variant


def method_titles(params: Params) -> dict[str, str]:
    """Method -> title: the field, the second reference, and each row of ``baselines``.

    Rows with the same title also show their names.
    """
    rows: Mapping[str, BaselineOptions] = params.baselines
    own = (f"GPF, {params.render.spp} spp", f"SPPM, {passes_title(params.reference)} passes")
    titles = {name: row.title for name, row in rows.items()}
    counts = Counter([*own, *titles.values()])
    named = {m: title if counts[title] == 1 else f"{title} ({m})" for m, title in titles.items()}
    return dict(zip(OWN_METHODS, own, strict=True)) | named


def passes_title(section: ReferenceSettings) -> str:
    """The number of reference passes, as text."""
    return f"at most {section.passes}" if section.target_psnr else str(section.passes)


def variant_title(variant: Variant) -> str:
    """The title of a variant; without one, its settings."""
    settings = ", ".join(f"{key}: {value}" for key, value in variant.set.items())
    return variant.title or settings or "default"
