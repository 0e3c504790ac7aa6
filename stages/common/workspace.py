"""The paths of the pipeline's files, and the data that every stage starts with."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from gpf.core.errors import FileError, UserError
from gpf.core.runtime import choose_variant
from gpf.guiding.emission_plan import EmissionPlan
from gpf.scene.folders import scene_folder
from gpf.scene.load import load_scene_file
from gpf.scene.sensors import make_sensor
from gpf.scene.views import SceneViews, View, read_views
from stages.config.memory import refuse_too_large
from stages.config.params import Params, read_params


@dataclass(frozen=True)
class Workspace:
    """The parameters, and the files of one scene under ``results/``.

    Attributes
    ----------
    params: the parameters in params.yaml, or a variant's.
    root: ``results/``.
    variant_folder: folder of a variant's field and of the files made from it; None for the field
        itself.
    """

    params: Params
    scene: str
    root: Path = Path("results")
    variant_folder: Path | None = None

    @classmethod
    def open(cls, scene: str) -> Workspace:
        """Read params.yaml, check that there is enough memory for it and that the scene
        exists, and choose the Mitsuba variant."""
        params = read_params()
        refuse_too_large(params)
        scene_folder(scene)
        choose_variant(params.runtime.variant)
        return cls(params, scene)

    def variant(self, params: Params, folder: Path) -> Workspace:
        """The same scene and references, with a field of other parameters in another folder."""
        return replace(self, params=params, variant_folder=folder)

    @property
    def folder(self) -> Path:
        """The folder of all files of the scene."""
        return self.root / self.scene

    @property
    def field_folder(self) -> Path:
        """The folder of the field and of the files made from it."""
        return self.variant_folder or self.folder

    @property
    def scene_snapshot(self) -> Path:
        """The copy of the scene that the stage ``scene`` made."""
        return self.folder / "scene"

    @property
    def views_file(self) -> Path:
        """The cameras; not in the snapshot, because a new view does not change the photons."""
        return self.folder / "views.yaml"

    @property
    def targets(self) -> Path:
        """Supervised points and their irradiance."""
        return self.folder / "targets.safetensors"

    @property
    def surfaces(self) -> Path:
        """Irradiance at samples of the scene's surfaces."""
        return self.folder / "reference" / "surfaces.safetensors"

    @property
    def photons(self) -> Path:
        """The photons that become Gaussians."""
        return self.folder / "photons.safetensors"

    @property
    def field(self) -> Path:
        """The fitted field."""
        return self.field_folder / "field.safetensors"

    def reference(self, view: str) -> Path:
        """The reference image of a view."""
        return self.folder / "reference" / f"{view}.exr"

    def second_reference(self, view: str) -> Path:
        """A second, independent reference of a novel view, after several numbers of passes."""
        return self.folder / "second_reference" / f"{view}.exr"

    def renders(self, method: str) -> Path:
        """The folder of a method's images."""
        return self.field_folder / "renders" / method

    def render(self, method: str, view: str) -> Path:
        """A method's image of a view."""
        return self.renders(method) / f"{view}.exr"

    def refusal(self, method: str) -> Path:
        """The file with the reason why a method has no images."""
        return self.renders(method) / "cannot_serve.json"

    def metrics(self, method: str) -> Path:
        """The comparison of a method's images with the references."""
        return self.folder / "metrics" / f"{method}.json"

    @property
    def summary(self) -> Path:
        """The numbers of all methods, means over views."""
        return self.folder / "summary.json"

    @property
    def convergence(self) -> Path:
        """PSNR of SPPM by number of passes."""
        return self.folder / "convergence.json"

    @property
    def all_costs(self) -> Path:
        """The costs of all stages; in one folder for all scenes, for results that need them all."""
        return self.root / "costs" / f"{self.scene}.csv"

    def cost(self, stage: str) -> Path:
        """The costs of a stage."""
        return self.field_folder / "costs" / f"{stage}.json"

    def checkpoint(self, stage: str) -> Path:
        """The checkpoint of a stage."""
        return self.field_folder / "checkpoints" / f"{stage}.safetensors"

    def pass_parts(self, group: str) -> Path:
        """The folder with the parts of a reference group's passes."""
        return self.folder / "checkpoints" / f"reference-{group}"

    def forget_checkpoints(self) -> None:
        """Remove the folder of checkpoints if it is empty."""
        folder = self.folder / "checkpoints"
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()

    @cached_property
    def views(self) -> SceneViews:
        """The cameras of the scene.

        Raises
        ------
        UserError: the file is missing or not valid.
        """
        if not self.views_file.exists():
            raise FileError(self.views_file, "is missing", missing=True)
        return read_views(self.views_file)

    def novel_views(self) -> tuple[View, ...]:
        """The novel views.

        Raises
        ------
        UserError: there are none.
        """
        if not self.views.novel:
            raise UserError(str(self.views_file), "has no novel views", "Add some to render.")
        return self.views.novel

    @cached_property
    def scene_digest(self) -> str:
        """A hash of all files of the scene."""
        digest = hashlib.sha256()
        for path in sorted(self.scene_snapshot.rglob("*")):
            if path.is_file():
                digest.update(path.relative_to(self.scene_snapshot).as_posix().encode())
                digest.update(path.read_bytes())
        return digest.hexdigest()[:16]

    @staticmethod
    def digest(path: Path) -> str:
        """A hash of a file's content; an empty string if the file does not exist."""
        return hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path.exists() else ""

    def load_scene(self) -> Any:
        """The Mitsuba scene, checked.

        Raises
        ------
        UserError: the scene is missing or not valid.
        """
        file = self.scene_snapshot / "scene.xml"
        if not file.exists():
            raise FileError(self.scene_snapshot, "is missing", missing=True)
        return load_scene_file(file)

    def emission_plan(self, scene: Any) -> EmissionPlan:
        """Where photons are needed, and how they are emitted."""
        # Always the same size, so that photons do not depend on the film size.
        sensors = [make_sensor(view, *self.views.size(256)) for view in self.views.train]
        reference = self.params.reference
        return EmissionPlan.make(
            scene, sensors, self.params.visible_region, reference.rr_depth, reference.direct
        )

    @property
    def film_size(self) -> tuple[int, int]:
        """Width and height of all images, pixels."""
        return self.views.size(self.params.film.height)

    def sensor(self, view: View, spp: int = 1, sampler: str = "independent") -> Any:
        """A Mitsuba sensor for a view, with the film size of params.yaml."""
        return make_sensor(view, *self.film_size, spp=spp, sampler=sampler)
