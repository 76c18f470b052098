"""Many sessions, each measured into a folder of its own, and one table of what came out."""

from vfm_sdm.studies.batch.run import batch
from vfm_sdm.studies.batch.sessions import find_sessions
from vfm_sdm.studies.batch.table import BatchRow, write_rows

__all__ = ["BatchRow", "batch", "find_sessions", "write_rows"]
