"""The part ``matrices``: a linear model from the matrix files of another program."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import Field

from kc2spice.bodies.readers import list_source_files, locate_model, measure_mesh_extent, read_model
from kc2spice.bodies.readers.raw_matrices import TRANSLATIONS
from kc2spice.core.domains import ACCELERATION, TRANSLATION
from kc2spice.core.figure import Shape
from kc2spice.core.progress import StageTimer
from kc2spice.core.untrusted_files import locate_file_in_folder
from kc2spice.parts.bodies._body_model import hash_file
from kc2spice.parts.bodies._linear_body import LinearBody
from kc2spice.parts.bodies._linear_body_keys import LinearKeys
from kc2spice.rom.linear_model import LinearModel, Port
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import DeclaredScene, GovernedScene, Part, Scene, WiredScene
from kc2spice.scene.settings import FileName

LINE_HEIGHT = 0.02  # smallest height of a mesh in a drawing, divided by its width


class MatricesKeys(LinearKeys):
    """Keys of a model from matrix files; a TOML file describes its ports."""

    file: FileName = Field(
        examples=['"FILE"'],
        description=(
            "Matrix file in the scene's folder, or NAME for several matrix files NAME.M, NAME.K, …"
        ),
    )
    sidecar: FileName | None = Field(
        None,
        description=(
            "TOML file that describes the ports of the matrices; by default the name of "
            "the matrix file with the extension .toml"
        ),
    )


class Matrices(LinearBody[MatricesKeys]):
    """Part type ``matrices``: linear model, reduced from another program's matrices."""

    name = "matrices"
    origin_of_pins = (
        "The pins of a part are the pins of the ports in its TOML file, which the key `sidecar` "
        "names."
    )
    title = "linear model from the matrices of another tool, reduced"
    schema = MatricesKeys
    source = "matrices of another tool"
    ports_of_files = True
    data_temperature = ""

    def ports(self, part: Part[MatricesKeys], scene: DeclaredScene) -> tuple[Port, ...]:
        """Return the ports of the part's model."""
        return self._read_model(part, scene).ports

    def pin_directions(
        self, part: Part[MatricesKeys], scene: DeclaredScene
    ) -> Mapping[str, tuple[float, ...]]:
        """Return the direction of each translational port, keyed by the pin of the port.

        The key ``dof`` or ``axis`` in the TOML file states the direction. A port that is stated as
        a column of the input matrix B has no direction.
        """
        *_, sidecar = locate_model(*self._find_paths(part, scene))
        result = {}
        for entry in sidecar.ports:
            translation = entry.kind in (TRANSLATION.port, ACCELERATION.port)
            if translation and entry.weights.keys() and entry.weights.keys() <= {*TRANSLATIONS}:
                pin = entry.port.terminals[0]
                result[pin] = tuple(entry.weights.get(axis, 0.0) for axis in TRANSLATIONS)
        return result

    def constant_pins(self, part: Part[MatricesKeys], scene: WiredScene) -> Mapping[str, str]:
        """Return the reference pin; none for a model whose mass matrix is zero."""
        M = self._read_model(part, scene).M
        massless = M is not None and not abs(M).max()
        return {} if massless else super().constant_pins(part, scene)

    def make_full_model_key(self, part: Part[MatricesKeys], scene: GovernedScene) -> dict[str, Any]:
        """Return the cache key of the full model, with hashes of the matrix files."""
        return {**super().make_full_model_key(part, scene), "files": self._hash_files(part, scene)}

    def _hash_files(self, part: Part[MatricesKeys], scene: DeclaredScene) -> dict[str, str]:
        """Return the content hash of each matrix file, keyed by its path."""
        return {name: hash_file(scene.home / name) for name in self.files(part, scene)}

    def files(self, part: Part[MatricesKeys], scene: DeclaredScene) -> tuple[str, ...]:
        """Return the paths of the matrix files and the TOML file, relative to the scene."""
        result = list_source_files(*self._find_paths(part, scene))
        return tuple(os.path.relpath(path, scene.home) for path in result)

    def make_full_model(
        self, part: Part[MatricesKeys], scene: GovernedScene, clock: StageTimer
    ) -> LinearModel:
        """Return the full model from the matrix files."""
        return self._read_model(part, scene)

    def outline(self, part: Part[MatricesKeys], scene: Scene) -> Iterator[Shape]:
        """Yield the bounding box of the mesh in side view, if the TOML file names a mesh."""
        size = measure_mesh_extent(*self._find_paths(part, scene))
        if size is None or not size[:2].any():
            return
        wide, high = float(size[:2].max()), float(size[2] or size[:2].min())
        high = max(high, LINE_HEIGHT * wide)
        yield Shape(0.0, -high / 2, wide, high, label=part.name)

    def _read_model(self, part: Part[MatricesKeys], scene: DeclaredScene) -> LinearModel:
        """Read the model from the matrix files of the part."""
        return _read_model_files(*self._find_paths(part, scene), str(self._hash_files(part, scene)))

    def _find_paths(
        self, part: Part[MatricesKeys], scene: DeclaredScene
    ) -> tuple[Path, Path | None]:
        """Return the paths of the matrix file and of its TOML file (None without one)."""
        name, home, keys = part.name, scene.get_folder(part), part.keys
        sidecar = (
            None
            if keys.sidecar is None
            else locate_file_in_folder(home, keys.sidecar, f"{name}.sidecar")
        )
        return locate_file_in_folder(home, keys.file, f"{name}.file"), sidecar


@lru_cache(maxsize=4)
def _read_model_files(path: Path, sidecar: Path | None, stamps: str) -> LinearModel:
    """Read a linear model from its files, cached by path and by content hashes."""
    return read_model(path, sidecar)


register_part_type(Matrices())
