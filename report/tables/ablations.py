"""Tables 3, S1, S2 and that of the field's switches: the field, made otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from gpf.config.titles import variant_title
from metrics.stage_costs import learning_seconds
from report.formats import fixed, join, signed, significant, whole
from report.paper import Variant, read_paper
from report.results import FIELD, NUMBERS, Results
from report.table import Column, Row, Table, Value
from report.tables.columns import BEST, FLIP, PAPER, PSNR, SECONDS, STORAGE

# Differences between variants are small.
SSIM = Column("ssim", "SSIM", fixed(4), "higher")
LPIPS = Column("lpips", "LPIPS", fixed(4), "lower")
DIFFERENCE = Column("psnr_difference", "Δ PSNR", signed(2))
TRAINING = Column("train_seconds", "Training, s", significant(3), "lower")
COUNT = Column("gaussians", "Gaussians", whole)
COLUMNS = (PSNR, DIFFERENCE, SSIM, LPIPS, FLIP, SECONDS, TRAINING, STORAGE)


@dataclass(frozen=True)
class Ablation:
    """A group of variants and the table that shows it.

    ``key``: the parameter of ``field`` that its rows are numbered by, if it is about one.
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
        "The field without parts of it: Gaussians at random places instead of photons, neighbours "
        "within the search radius or the k nearest alone.",
    ),
    Ablation(
        "gaussians",
        "table_s1",
        "Table S1: number of Gaussians",
        "How many Gaussians the field has.",
        "gaussians",
        "gaussians",
    ),
    Ablation(
        "k",
        "table_s2",
        "Table S2: k",
        "At least so many neighbours are blended, however far they are.",
        "k",
        "k",
    ),
    Ablation(
        "switches",
        "switches",
        "Switches of the field",
        "One setting at a time is another than the default; params.yaml explains them.",
    ),
)


@dataclass(frozen=True)
class Made:
    """A field, how it was made, and what came of it.

    Attributes
    ----------
    settings: the section ``field`` that it was made with, with the number of Gaussians it has.
    values: by the columns' keys; none where ``reason`` says why.
    gaps: why single values are missing.
    changed: the keys of params.yaml in which it is not the default.
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
    """A group of variants, scene by scene, with the default field among them."""
    paper = read_paper().ablations
    asked = results.params.ablations.scenes
    rows: list[Row] = []
    for scene in results.scenes:
        # The paper's rows have their place even where nothing was varied.
        in_paper = scene == paper.scene and paper.of(ablation.group)
        if in_paper or scene in asked:
            rows += _rows_of(results, scene, ablation)
    own = (COUNT,) if ablation.key != "gaussians" else ()
    compared = f" {PAPER}" if any(row.paper for row in rows) else ""
    return Table(
        name=ablation.name,
        title=ablation.title,
        caption=f"{ablation.caption} Means over novel views; Δ: against the default.{compared} "
        f"{BEST}",
        columns=(*COLUMNS, *own),
        rows=tuple(rows),
        label=ablation.label,
        grouped_by="scene",
        remarks=_remarks(results, ablation, rows),
    )


def _remarks(results: Results, ablation: Ablation, rows: Sequence[Row]) -> tuple[str, ...]:
    """Why there are no rows, and what has none though there is a file of it."""
    asked, remarks = results.params.ablations, []
    if not asked.scenes and not rows:
        remarks.append("No scene is asked for: `ablations.scenes` in params.yaml lists none.")
    elif not rows:
        remarks.append("No scene with ablations has been measured yet.")
    # No stage keeps those up to date, so that their numbers may be of other sizes.
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
        made = Made(theirs.title, theirs.field, {}, "no variant in params.yaml is made so")
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
    """What to sort by, and the row."""
    number = made.settings.get(ablation.key, 0)
    place = float(number) if isinstance(number, int) else float("inf")
    label = made.title
    # What changes more than the number has a title of its own.
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
    """The field as the pipeline makes it."""
    cost = results.scene(scene).read("costs", "train.json")
    values = results.row(scene, FIELD)
    if cost:
        values["train_seconds"] = learning_seconds(cost)
        values["gaussians"] = float(cost["facts"]["gaussians"])
    settings = _settings(results, {}, values.get("gaussians"))
    gaps = results.reasons(scene, FIELD)
    return Made("all", settings, values, gaps.get("", ""), gaps=gaps, default=True)


def _variants(results: Results, scene: str, group: str, default: Made) -> list[Made]:
    """Those of params.yaml in its order; what changes nothing is the default by another name."""
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
            reason = "not asked for: `ablations.run` in params.yaml does not list it"
        elif scene not in section.scenes:
            reason = "not asked for: `ablations.scenes` in params.yaml does not list the scene"
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
"""Column -> what the file calls it."""


def _changes_nothing(results: Results, overrides: Mapping[str, Any], default: Made) -> bool:
    """Whether a variant is the field as it is."""
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
    """The section ``field`` with what a variant changes."""
    settings = results.params.field.model_dump(mode="json")
    for key, value in overrides.items():
        if key.startswith("field."):
            settings[key.removeprefix("field.")] = value
    return settings | ({} if gaussians is None else {"gaussians": int(gaussians)})


def _agrees(theirs: Variant, made: Made) -> bool:
    """Whether a field is made as a row of the paper says, which are about the field alone."""
    alone = all(key.startswith("field.") for key in made.changed)
    return alone and all(made.settings.get(key) == value for key, value in theirs.field.items())
