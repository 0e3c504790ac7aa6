"""Materials of a description (:mod:`baselines.translation.materials`) as LuxCore's.

LuxCore's rough surfaces follow Schlick's distribution, which is GGX with other shadowing; its
plastic is a diffuse base under Schlick's approximation of a coat.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from baselines.luxcore.properties import Properties, colour
from baselines.protocol import CannotServe
from gpf.core.images import write_exr

Material = Mapping[str, Any]
Value = Any

SMOOTHEST = 1e-3
"""α of a smooth metal or coat: those of LuxCore that reflect in a single direction have no
Fresnel term."""


class Materials:
    """Writes materials and their textures.

    Parameters
    ----------
    folder: with the description; images are written there.
    where: names the scene in messages.
    """

    def __init__(self, folder: Path, where: str) -> None:
        self.folder, self.where = folder, where
        self.properties: Properties = {}
        self._files: dict[str, str] = {}
        self._count = 0

    def add(
        self, material: Material, radiance: Value = None, bent: Properties | None = None
    ) -> str:
        """Add a material whose front may shine; its name.

        ``bent``: its bump or normal map.

        Raises
        ------
        CannotServe: LuxCore has no such material.
        """
        kind = material["kind"]
        if kind in ("bump", "normals"):
            return self.add(material["inside"], radiance, self._bend(material))
        if radiance is not None and kind != "sides":
            return self.add({"kind": "sides", "front": material, "back": material}, radiance, bent)
        if kind == "mix" and material["first"]["kind"] == "clear":
            name = self.add(material["second"], radiance, bent)
            opacity = self.number(material["weight"])
            self.properties[f"scene.materials.{name}.transparency"] = opacity
            return name
        if kind == "sides":
            front = self._plain(material["front"], bent, radiance)
            found = {"frontmaterial": front, "backmaterial": self.add(material["back"], None, bent)}
            if radiance is not None:  # otherwise, large meshes are hit by chance alone
                found["emission.directlightsampling.type"] = "ENABLED"
            return self._name({"type": "twosided", **found})
        return self._plain(material, bent, None)

    def _plain(self, material: Material, bent: Properties | None, radiance: Value) -> str:
        if material["kind"] in ("bump", "normals"):
            return self._plain(material["inside"], self._bend(material), radiance)
        found = getattr(self, f"_{material['kind']}")(material) | (bent or {})
        if radiance is not None:
            found["emission"] = self.value(radiance)
            found["emission.normalizebycolor"] = False
        return self._name(found)

    def _name(self, found: Properties) -> str:
        self._count += 1
        name = f"material_{self._count}"
        self.properties |= {f"scene.materials.{name}.{key}": v for key, v in found.items()}
        return name

    def _texture(self, found: Properties) -> str:
        self._count += 1
        name = f"texture_{self._count}"
        self.properties |= {f"scene.textures.{name}.{key}": v for key, v in found.items()}
        return name

    def value(self, value: Value) -> Any:
        """A colour, or the name of an image's texture."""
        return self._texture(self._image(value)) if isinstance(value, dict) else colour(value)

    def number(self, value: Value) -> Any:
        """A number, or the name of an image's texture."""
        if isinstance(value, dict):
            return self.value(value)
        return float(np.dot(colour(value), (0.2126, 0.7152, 0.0722)))

    def file(self, name: str, flipped: bool = False) -> str:
        """An image of the description as EXR."""
        if name not in self._files:
            path = self.folder / f"{Path(name).stem}.exr"
            pixels = np.load(self.folder / name)
            write_exr(path, {"radiance": pixels[:, ::-1] if flipped else pixels}, {})
            self._files[name] = str(path)
        return self._files[name]

    def _image(self, value: Mapping[str, Any]) -> Properties:
        if "attribute" in value:
            raise self.refuse("no colours at vertices")
        (a, b, u), (c, d, v) = value["to_uv"]
        turn, across = math.atan2(c, a), math.hypot(a, c)
        if abs(a * b + c * d) > 1e-4 * across * math.hypot(b, d):
            raise self.refuse("no sheared textures")
        return {
            "type": "imagemap",
            "file": self.file(value["image"]),
            "gamma": 1.0,
            "storage": "float",
            "filter": "nearest" if value["nearest"] else "linear",
            "wrap": {"mirror": "repeat"}.get(value["wrap"], value["wrap"]),
            "mapping.type": "uvmapping2d",
            "mapping.rotation": -math.degrees(turn),
            "mapping.uvscale": [across, (a * d - b * c) / across],
            "mapping.uvdelta": [u, v],
        }

    def refuse(self, what: str) -> CannotServe:
        """The error for what LuxCore cannot express."""
        return CannotServe(self.where, what, "Leave the system out for this scene.")

    def _bend(self, material: Material) -> Properties:
        if material["kind"] == "normals":
            return {"normaltex": self._texture(self._image(material["map"]))}
        scaled = {"type": "scale", "texture1": self._texture(self._image(material["height"]))}
        return {"bumptex": self._texture(scaled | {"texture2": float(material["scale"])})}

    def _diffuse(self, material: Material) -> Properties:
        return {"type": "matte", "kd": self.value(material["color"])}

    def _translucent(self, material: Material) -> Properties:
        through = self.value(material["color"])
        return {"type": "mattetranslucent", "kr": colour(0), "kt": through}

    def _clear(self, material: Material) -> Properties:
        return {"type": "null"}

    def _roughness(self, material: Material) -> Properties:
        alpha = [max(a, SMOOTHEST) if isinstance(a, float) else a for a in material["alpha"]]
        return {f"{axis}roughness": self.number(a) for axis, a in zip("uv", alpha, strict=True)}

    def _conductor(self, material: Material) -> Properties:
        if material["eta"] is None and material["alpha"] == [0.0, 0.0]:
            return {"type": "mirror", "kr": self.value(material["tint"])}
        found = {"type": "metal2", **self._roughness(material)}
        plain = not isinstance(material["tint"], dict) and colour(material["tint"]) == colour(1)
        if material["eta"] is not None and plain:
            return found | {"n": colour(material["eta"]), "k": colour(material["k"])}
        ahead = 1.0
        if material["eta"] is not None:
            eta, k = (np.array(colour(material[key])) for key in ("eta", "k"))
            ahead = ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)
        tint = self._scaled(material["tint"], ahead)
        return found | {"fresnel": self._texture({"type": "fresnelcolor", "kr": tint})}

    def _scaled(self, value: Value, factor: Any) -> Any:
        if not isinstance(value, dict):
            return colour(np.array(colour(value)) * factor)
        found = {"type": "scale", "texture1": self.value(value), "texture2": colour(factor)}
        return self._texture(found)

    def _dielectric(self, material: Material) -> Properties:
        tints = {"kr": material["reflectance"], "kt": material["transmittance"]}
        found: Properties = {key: self.value(tint) for key, tint in tints.items()}
        found |= {"interiorior": float(material["ior"]), "exteriorior": 1.0}
        if material["alpha"] == [0.0, 0.0]:
            return {"type": "glass", **found}
        return {"type": "roughglass", **found, **self._roughness(material)}

    def _thin(self, material: Material) -> Properties:
        return self._dielectric({**material, "alpha": [0.0, 0.0]}) | {"type": "archglass"}

    def _plastic(self, material: Material) -> Properties:
        f0 = ((material["ior"] - 1) / (material["ior"] + 1)) ** 2
        coat = self._scaled(material["specular"], f0)
        found = {"type": "glossy2", "kd": self.value(material["color"]), "ks": coat}
        return found | self._roughness(material)

    def _principled(self, material: Material) -> Properties:
        through = material["spec_trans"]
        if through == 1:
            return self._clear_principled(material)
        if through != 0:
            raise self.refuse("principled materials that transmit a part of the light")
        names = ("metallic", "roughness", "anisotropic", "sheen", "clearcoat")
        f0 = ((material["ior"] - 1) / (material["ior"] + 1)) ** 2
        return {
            "type": "disney",
            "basecolor": self.value(material["base_color"]),
            "specular": min(f0 / 0.08, 1.0),
            "speculartint": self.number(material["spec_tint"]),
            "sheentint": self.number(material["sheen_tint"]),
            "clearcoatgloss": self.number(material["clearcoat_gloss"]),
            **{name: self.number(material[name]) for name in names},
        }

    def _clear_principled(self, material: Material) -> Properties:
        base, rough = material["base_color"], material["roughness"]
        if isinstance(base, dict) or isinstance(rough, dict):
            raise self.refuse("textured principled materials that transmit light")
        tint = np.sqrt(colour(base)).tolist()
        glass = {"ior": material["ior"], "reflectance": 1.0, "transmittance": tint}
        return self._dielectric({**glass, "alpha": [rough**2, rough**2]})

    def _mix(self, material: Material) -> Properties:
        first, second = (self.add(material[key]) for key in ("first", "second"))
        found = {"type": "mix", "material1": first, "material2": second}
        return found | {"amount": self.number(material["weight"])}
