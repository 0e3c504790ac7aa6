"""Tables 3, S1, S2 and the table of switches: variants of the field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from metrics.stage_costs import learning_seconds
from report.formats import fixed, join, signed, significant, whole
from report.paper import Variant, read_paper
from report.results import FIELD, NUMBERS, Results
from report.table import Column, Row, Table, Value
from report.tables.columns import BEST, FLIP, PAPER, PSNR, SECONDS, STORAGE
from stages.config.titles import variant_title

# Differences between variants are small.
SSIM = Column("ssim", "SSIM", fixed(4), "higher")
LPIPS = Column("lpips", "LPIPS", fixed(4), "lower")
DIFFERENCE = Column("psnr_difference", "Δ PSNR", signed(2))
TRAINING = Column("train_seconds", "Training, s", significant(3), "lower")
COUNT = Column("gaussians", "Gaussians", whole)
COLUMNS = (PSNR, DIFFERENCE, SSIM, LPIPS, FLIP, SECONDS, TRAINING, STORAGE)


@dataclass(frozen=True)
class Ablation:
    """A group of variants and its table.

    Attributes
    ----------
    key: the parameter of ``field`` that the group varies, for labels and order; "" if there are
        several.
    """

    group: str
    name: str
    title: str
    caption: str
    label: str = "variant"
    key: str = ""


ABLATIONS = (
    Ablation(
        "components",
        "table_3",
        "Table 3: components",
        "Parts of the field replaced: Gaussians at random places instead of at photons; only the "
        "neighbours within the search radius, or only the k nearest.",
    ),
    Ablation(
        "gaussians",
        "table_s1",
        "Table S1: number of Gaussians",
        "The field with different numbers of Gaussians.",
        "gaussians",
        "gaussians",
    ),
    Ablation(
        "k",
        "table_s2",
        "Table S2: k",
        "At least k neighbours are blended, whatever their distance.",
        "k",
        "k",
    ),
    Ablation(
        "switches",
        "switches",
        "Switches of the field",
        "Each variant changes one setting; params.yaml explains the settings.",
    ),
)


@dataclass(frozen=True)
class Made:
    """A field, its settings and its numbers.

    Attributes
    ----------
    settings: its section ``field``, with the number of Gaussians that it has.
    values: numbers by column key.
    reason: why there are no numbers at all.
    changed: keys of params.yaml that differ from the default field.
    gaps: why some numbers are missing, by column key.
    default: whether it is the default field.
    """

    title: str
    settings: Mapping[str, Any]
    values: Mapping[str, float]
    reason: str = ""
    changed: tuple[str, ...] = ()
    gaps: Mapping[str, str] = field(default_factory=dict)
    default: bool = False


def ablation_tables(results: Results) -> list[Table]:
    """The four tables."""
    return [ablation_table(results, ablation) for ablation in ABLATIONS]


def ablation_table(results: Results, ablation: Ablation) -> Table:
    """The table of a group: its variants and the default field, for each scene."""
    paper = read_paper().ablations
    asked = results.params.ablations.scenes
    rows: list[Row] = []
    for scene in results.scenes:
        # The paper's rows are shown even if no variant was run.
        in_paper = scene == paper.scene and paper.of(ablation.group)
        if in_paper or scene in asked:
            rows += _rows_of(results, scene, ablation)
    own = (COUNT,) if ablation.key != "gaussians" else ()
    compared = f" {PAPER}" if any(row.paper for row in rows) else ""
    return Table(
        name=ablation.name,
        title=ablation.title,
        caption=f"{ablation.caption} Means over novel views. Δ: difference from the default."
        f"{compared} {BEST}",
        columns=(*COLUMNS, *own),
        rows=tuple(rows),
        label=ablation.label,
        grouped_by="scene",
        remarks=_remarks(results, ablation, rows),
    )


def _remarks(results: Results, ablation: Ablation, rows: Sequence[Row]) -> tuple[str, ...]:
    """Remarks: why there are no rows, and which files have no row."""
    asked, remarks = results.params.ablations, []
    if not asked.scenes and not rows:
        remarks.append("`ablations.scenes` in params.yaml lists no scene.")
    elif not rows:
        remarks.append("No scene with ablations has been measured yet.")
    # No stage keeps these files up to date; their numbers may be of images of another size.
    left = [
        f"{file['title']} ({results.scene(scene).title})"
        for scene in results.scenes
        for name, file in results.scene(scene).ablations.items()
        if file["group"] == ablation.group and not asked.asks_for(scene, name)
    ]
    if left:
        remarks.append(f"On file, but not listed by `ablations` in params.yaml: {join(left)}.")
    return tuple(remarks)


def _rows_of(results: Results, scene: str, ablation: Ablation) -> list[Row]:
    paper = read_paper().ablations
    default = _default(results, scene)
    fields = _variants(results, scene, ablation.group, default)
    if not any(made.default for made in fields):
        fields.insert(0, default)
    left = list(paper.of(ablation.group)) if scene == paper.scene else []
    rows: list[tuple[float, Row]] = []
    for made in fields:
        theirs = next((v for v in left if _agrees(v, made)), None)
        if theirs is not None:
            left.remove(theirs)
        rows.append(_row(results, scene, ablation, made, default, theirs))
    for theirs in left:
        made = Made(theirs.title, theirs.field, {}, "no variant in params.yaml has these settings")
        rows.append(_row(results, scene, ablation, made, default, theirs))
    if ablation.key:
        rows.sort(key=lambda pair: pair[0])
    return [row for _, row in rows]


def _row(
    results: Results,
    scene: str,
    ablation: Ablation,
    made: Made,
    default: Made,
    theirs: Variant | None,
) -> tuple[float, Row]:
    """The sort key and the row."""
    number = made.settings.get(ablation.key, 0)
    place = float(number) if isinstance(number, int) else float("inf")
    label = made.title
    # A variant that changes more than this number keeps its title.
    numbered = ablation.key and set(made.changed) <= {f"field.{ablation.key}"}
    if numbered and isinstance(number, int):
        label = whole(number)
    if made.default:
        label = f"{label} (default)" if ablation.key else "all (default)"
    values: dict[str, Value] = dict(made.values)
    if "psnr" in made.values and "psnr" in default.values and not made.default:
        values["psnr_difference"] = made.values["psnr"] - default.values["psnr"]
    elif made.default:
        values["psnr_difference"] = ""
    reasons = {"": made.reason} if made.reason else made.gaps
    reported = theirs.known if theirs else {}
    group = results.scene(scene).title
    return place, Row(label, values, reported, group, reasons, ours=made.default)


def _default(results: Results, scene: str) -> Made:
    """The default field."""
    cost = results.scene(scene).read("costs", "train.json")
    values = results.row(scene, FIELD)
    if cost:
        values["train_seconds"] = learning_seconds(cost)
        values["gaussians"] = float(cost["facts"]["gaussians"])
    settings = _settings(results, {}, values.get("gaussians"))
    gaps = results.reasons(scene, FIELD)
    return Made("all", settings, values, gaps.get("", ""), gaps=gaps, default=True)


def _variants(results: Results, scene: str, group: str, default: Made) -> list[Made]:
    """The variants of params.yaml, in its order. One that changes nothing is the default field."""
    section, found = results.params.ablations, results.scene(scene).ablations
    fields = []
    for name, variant in section.variants.items():
        if variant.group != group:
            continue
        if _changes_nothing(results, variant.set, default):
            fields.append(replace(default, title=variant_title(variant)))
            continue
        if name in found and section.asks_for(scene, name):
            fields.append(_from_file(results, found[name]))
            continue
        reason = "not run"
        if name not in section.run:
            reason = "not listed in `ablations.run` of params.yaml"
        elif scene not in section.scenes:
            reason = "scene not listed in `ablations.scenes` of params.yaml"
        settings = _settings(results, variant.set, None)
        fields.append(Made(variant_title(variant), settings, {}, reason, tuple(variant.set)))
    return fields


def _from_file(results: Results, file: Mapping[str, Any]) -> Made:
    settings = _settings(results, file["overrides"], file.get("gaussians"))
    title, changed = file["title"], tuple(file["overrides"])
    if "mean" not in file:
        return Made(title, settings, {}, file.get("reason", "not measured"), changed)
    mean = file["mean"]
    known = {key: mean[key] for key in NUMBERS if mean.get(key) is not None}
    known |= {key: file[name] for key, name in _COSTS.items() if file.get(name) is not None}
    return Made(title, settings, known, changed=changed, gaps=file.get("reasons", {}))


_COSTS = {
    "seconds_per_view": "seconds_per_view",
    "storage_mb": "storage_megabytes",
    "train_seconds": "train_seconds",
    "gaussians": "gaussians",
}
"""Column -> its key in the file."""


def _changes_nothing(results: Results, overrides: Mapping[str, Any], default: Made) -> bool:
    """Whether a variant has the same settings as the default field."""
    params = results.params.model_dump(mode="json") | {"field": default.settings}

    def value(key: str) -> Any:
        found: Any = params
        for part in key.split("."):
            found = found[part]
        return found

    return all(value(key) == wanted for key, wanted in overrides.items())


def _settings(
    results: Results, overrides: Mapping[str, Any], gaussians: float | None
) -> dict[str, Any]:
    """The section ``field`` with a variant's changes."""
    settings = results.params.field.model_dump(mode="json")
    for key, value in overrides.items():
        if key.startswith("field."):
            settings[key.removeprefix("field.")] = value
    return settings | ({} if gaussians is None else {"gaussians": int(gaussians)})


def _agrees(theirs: Variant, made: Made) -> bool:
    """Whether a field has the settings of a row in the paper and changes no other section."""
    alone = all(key.startswith("field.") for key in made.changed)
    return alone and all(made.settings.get(key) == value for key, value in theirs.field.items())
