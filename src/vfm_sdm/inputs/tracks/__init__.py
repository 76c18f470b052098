"""Finished tracks of other programs: a table (CSV), poses of ``movement``, and results of DICe and OpenCorr."""

from collections.abc import Callable
from pathlib import Path

from vfm_sdm.errors import ResultsError
from vfm_sdm.inputs.tracks.correlation import is_correlation, read_correlation
from vfm_sdm.inputs.tracks.poses import read_poses
from vfm_sdm.inputs.tracks.record import ForeignTracks
from vfm_sdm.inputs.tracks.table import is_table, read_table

__all__ = ["ForeignTracks", "read_foreign_tracks"]

_TEXTS: tuple[tuple[Callable[[str], bool], Callable[[Path], ForeignTracks]], ...] = (
    (is_table, read_table),
    (is_correlation, read_correlation),
)


def read_foreign_tracks(path: Path | str) -> ForeignTracks:
    """Tracks of one view, in whatever of the known forms they are.

    Parameters
    ----------
    path
        A table or a netCDF file; of programs that write a file a frame, their folder.

    Raises
    ------
    ResultsError
        It cannot be read, or is of no known form.
    """
    source = Path(path)
    if source.suffix.lower() == ".nc":
        return read_poses(source)
    if source.is_dir():
        return read_correlation(source)
    try:
        with source.open(encoding="utf-8-sig") as stream:
            head = next((line for line in stream if line.strip() and not line.startswith(("#", "***"))), "")
    except OSError as error:
        raise ResultsError(f"{source}: expected tracks as a table, got: {error}; check the path") from error
    except UnicodeDecodeError as error:
        raise ResultsError(f"{source}: expected a table in UTF-8, got: {error}; save it as CSV UTF-8") from error
    for is_it, read in _TEXTS:
        if is_it(head):
            return read(source)
    raise ResultsError(
        f"{source}: expected columns frame (or time_s), point, u, v, or those of DICe or OpenCorr, separated "
        f"by commas, got {head.strip()[:80]!r}; docs/tracks.md says which"
    )
