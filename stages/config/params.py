"""The whole params.yaml: its sections, checks across sections, and its variants."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from baselines.options import BaselineOptions
from gpf.core.settings import Settings
from gpf.core.yaml import explain, read_yaml, suggest
from gpf.guiding.emission_plan import VisibleRegionSettings
from gpf.guiding.photon_map import PhotonSettings
from gpf.rendering.settings import RenderSettings
from gpf.sppm.reference import ReferenceSettings
from gpf.training.streaming import StreamSettings
from stages.config.pipeline import (
    OWN_METHODS,
    VARIED,
    Ablations,
    Amortize,
    Animation,
    Cluster,
    Film,
    MethodName,
    Methods,
    Metrics,
    Progress,
    Runtime,
)
from stages.config.training import FieldTrainingSettings, InitialFieldSettings


class Params(Settings):
    """The whole params.yaml."""

    scenes: Annotated[tuple[str, ...], Field(min_length=1)]
    runtime: Runtime = Runtime()
    progress: Progress = Progress()
    film: Film = Film()
    visible_region: VisibleRegionSettings = VisibleRegionSettings()
    executor: Literal["local", "ray"] = "local"
    cluster: Cluster = Cluster()
    reference: ReferenceSettings = ReferenceSettings()
    photons: PhotonSettings = PhotonSettings()
    field: InitialFieldSettings = InitialFieldSettings()
    train: FieldTrainingSettings = FieldTrainingSettings()
    stream: StreamSettings = StreamSettings()
    render: RenderSettings = RenderSettings()
    methods: Methods = Methods()
    baselines: dict[MethodName, BaselineOptions] = Field(default_factory=dict)
    ablations: Ablations = Ablations()
    animation: Animation = Animation()
    metrics: Metrics = Metrics()
    amortize: Amortize = Amortize()

    def vary(self, overrides: Mapping[str, Any]) -> Params:
        """These parameters with new values for some dotted keys, and without ablations.

        Raises
        ------
        pydantic.ValidationError: an unknown key or a bad value.
        """
        data: dict[str, Any] = {name: getattr(self, name) for name in Params.model_fields}
        del data["ablations"]
        for key, value in overrides.items():
            *path, leaf = key.split(".")
            place = data
            for part in path:
                if isinstance(place.get(part), BaseModel):
                    place[part] = place[part].model_dump()
                # If this is not a section, the check below rejects the value or the key.
                if not isinstance(place.get(part), dict):
                    place[part] = {}
                place = place[part]
            place[leaf] = value
        return Params.model_validate(data)

    def variant(self, name: str, also: Mapping[str, Any] | None = None) -> Params:
        """The parameters of an ablation variant.

        ``also``: further dotted keys and values; those of the variant take precedence.
        """
        return self.vary({**(also or {}), **self.ablations.variants[name].set})

    @model_validator(mode="after")
    def _methods_are_known(self) -> Self:
        known, listed = list(self.baselines), self.methods.all
        for name in (*known, *listed):
            if name in OWN_METHODS:
                raise _objection(
                    f"{name} is reserved for a result of the pipeline itself",
                    "Give the row another name.",
                )
        for name in listed:
            if name not in known:
                todo = suggest(name, known, "The rows of baselines are")
                raise _objection(f"methods lists {name}, which is not in baselines", todo)
            if listed.count(name) > 1:
                raise _objection(f"methods lists {name} more than once", "Remove one.")
        for group in Methods.model_fields:
            for name in getattr(self.methods, group):
                fitting = self.baselines[name].lists
                if group not in fitting:
                    todo = f"List it under {' or '.join(f'methods.{g}' for g in fitting)}."
                    raise _objection(
                        f"methods.{group} lists {name}, which does not belong there", todo
                    )
        return self

    @model_validator(mode="after")
    def _ablations_can_be_run(self) -> Self:
        rows = self.ablations.variants
        for name, variant in rows.items():
            where = f"ablations.variants.{name}.set"
            for key in variant.set:
                if key.split(".")[0] not in VARIED or "." not in key:
                    todo = f"Keys must begin with one of: {', '.join(f'{v}.' for v in VARIED)}"
                    raise _objection(f"{where}: a variant cannot set {key}", todo)
            try:
                self.variant(name)
            except ValidationError as error:
                told = explain(where, Params, error)
                raise _objection(f"{told.where}: {told.what}", told.todo) from None
        for name in self.ablations.run:
            if name not in rows:
                todo = suggest(name, list(rows), "The rows of ablations.variants are")
                raise _objection(f"ablations.run: {name} is not among the variants", todo)
            if self.ablations.run.count(name) > 1:
                raise _objection(f"ablations.run: lists {name} more than once", "Remove one.")
        return self

    @model_validator(mode="after")
    def _scenes_and_methods_are_known(self) -> Self:
        for section in ("ablations", "animation"):
            for scene in getattr(self, section).scenes:
                if scene not in self.scenes:
                    todo = suggest(scene, self.scenes, "Remove it; the scenes are")
                    raise _objection(f"{section}.scenes: {scene} is not among the scenes", todo)
        known = ["gpf", *self.baselines]
        for method in self.animation.methods:
            if method not in known:
                todo = suggest(method, known, "The methods are")
                raise _objection(f"animation.methods: {method} is not a method", todo)
        return self

    @model_validator(mode="after")
    def _targets_separate_direct_light(self) -> Self:
        if self.field.direct == "emitters" and self.reference.direct != "emitters":
            raise _objection(
                "field.direct is emitters, but reference.direct is photons, which do not separate "
                "direct from indirect light",
                "Set both to emitters, or field.direct to field.",
            )
        return self


def _objection(what: str, todo: str) -> PydanticCustomError:
    """An error about several keys of params.yaml, and what the user can do about it."""
    return PydanticCustomError("params", "{what}", {"what": what, "todo": todo})


def read_params(file: Path = Path("params.yaml")) -> Params:
    """Read and check params.yaml; raises a :class:`gpf.core.errors.UserError` for any error."""
    return read_yaml(file, Params, "Run `gpf` in the project folder, which contains params.yaml.")
