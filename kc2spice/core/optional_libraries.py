"""Import of optional libraries, with an error that states how to install them.

All imports of optional libraries go through :func:`import_optional`. ``pyproject.toml`` states the
versions of the optional libraries.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

from kc2spice.core.errors import MissingToolError


class OptionalLibrary(NamedTuple):
    """Optional library: its name on PyPI, and the kc2spice extra that installs it.

    ``extra`` is None if no extra of kc2spice installs the library.
    """

    package: str
    extra: str | None

    @property
    def installation_command(self) -> str:
        """Command that installs the library.

        >>> OptionalLibrary("pyyeti", "nastran").installation_command
        "pip install 'kc2spice[nastran]'"
        """
        name = self.package if self.extra is None else f"'kc2spice[{self.extra}]'"
        return f"pip install {name}"


#: Optional libraries, keyed by the name of their top-level package.
OPTIONAL_LIBRARIES = {
    "ansys": OptionalLibrary("ansys-mapdl-reader", "ansys"),
    "distributed": OptionalLibrary("dask.distributed", "dask"),
    "h5py": OptionalLibrary("h5py", "meshes"),
    "InSpice": OptionalLibrary("InSpice", None),
    "mkl": OptionalLibrary("mkl", "fast"),
    "netCDF4": OptionalLibrary("netCDF4", "meshes"),
    "pandas": OptionalLibrary("pandas", "dataframes"),
    "pyarrow": OptionalLibrary("pyarrow", "parquet"),
    "pymor": OptionalLibrary("pyMOR", "pymor"),
    "PySpice": OptionalLibrary("PySpice", None),
    "pyyeti": OptionalLibrary("pyyeti", "nastran"),
    "skrf": OptionalLibrary("scikit-rf", "measured"),
    "xarray": OptionalLibrary("xarray", "dataframes"),
}


def import_optional(module: str, where: str) -> Any:
    """Import a module of an optional library; raise an error if it is not installed.

    The function restores the print options of numpy, which the library pyyeti changes.

    Parameters
    ----------
    module : str
        Dotted name of the module.
    where : str
        File, option or method that needs the module, for the error.

    Returns
    -------
    module
        The imported module.

    Raises
    ------
    MissingToolError : The library is not installed or cannot be loaded.
    """
    import numpy as np  # numpy is imported here, so that commands without arrays start faster

    top = module.partition(".")[0]
    library = OPTIONAL_LIBRARIES[top]
    try:
        with np.printoptions():
            return import_module(module)
    except ImportError as error:
        name = error.name or ""
        is_missing = isinstance(error, ModuleNotFoundError) and name.partition(".")[0] == top
        problem = "is not installed" if is_missing else "cannot be loaded"
        raise MissingToolError(
            f"{library.package} {problem}",
            where=where,
            got=None if is_missing else str(error) or type(error).__name__,
            hint=library.installation_command,
        ) from None
