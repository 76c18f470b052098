"""Points with their displacement by time as ParaView reads them: one VTK file a time, and a list of them."""

from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import xarray as xr

from vfm_sdm.core.files import write_file

__all__ = ["write_vtk"]

_MOST_FRAMES = 600


def write_vtk(folder: Path | str, field: xr.Dataset) -> Path:
    """Writes the line of a field as ``field.pvd`` beside a folder ``field-vtk``, and returns the path of the former.

    Parameters
    ----------
    folder
        Folder to write to.
    field
        Field dataset, shape (T, S, 3) [mm]; of more than 600 times, every so many are written.

    Raises
    ------
    ResultsError
        A file cannot be written.

    Notes
    -----
    Points are in metres and their displacement, a vector, too, so that "Warp By Vector" shows it at its size; the
    standard deviation is a vector beside it. The axes are the structure's: lateral, vertical (down), longitudinal.
    """
    place, step = Path(folder), -(-field.sizes["time"] // _MOST_FRAMES)
    points = field["position"].transpose("station", "axis").values
    entries = []
    for number, row in enumerate(range(0, field.sizes["time"], step)):
        frame = field.isel(time=row)
        arrays = {name: frame[name].transpose("station", "axis").values / 1000 for name in _VECTORS}
        file = f"field-vtk/{number:05d}.vtp"
        write_file(place / file, _polyline(points, arrays))
        entries.append(f'<DataSet timestep="{float(frame["time"]):.6f}" part="0" file={quoteattr(file)}/>')
    lines = ('<VTKFile type="Collection" version="0.1">', "<Collection>", *entries, "</Collection>", "</VTKFile>", "")
    return write_file(place / "field.pvd", '<?xml version="1.0"?>\n' + "\n".join(lines))


_VECTORS = ("displacement", "displacement_std")


def _polyline(points: np.ndarray, vectors: dict[str, np.ndarray]) -> str:
    """A line through points with vectors on them, as XML of VTK."""
    count = len(points)

    def array(kind: str, name: str, values: np.ndarray, components: int = 1) -> str:
        numbers = " ".join(f"{value:.9g}" for value in values.ravel())
        return (
            f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" format="ascii">'
            f"{numbers}</DataArray>"
        )

    data = "".join(array("Float64", name, values, 3) for name, values in vectors.items())
    lines = array("Int64", "connectivity", np.arange(count)) + array("Int64", "offsets", np.array([count]))
    return (
        '<?xml version="1.0"?>\n<VTKFile type="PolyData" version="0.1" byte_order="LittleEndian">\n<PolyData>\n'
        f'<Piece NumberOfPoints="{count}" NumberOfLines="1">\n<PointData Vectors="displacement">{data}</PointData>\n'
        f"<Points>{array('Float64', 'points', points, 3)}</Points>\n<Lines>{lines}</Lines>\n"
        "</Piece>\n</PolyData>\n</VTKFile>\n"
    )
