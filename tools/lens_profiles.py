"""Makes the table of lens profiles that comes with the package, from calibrations of consumer cameras.

Run as ``python tools/lens_profiles.py FOLDER`` on a folder that holds ``lens_profiles.csv.gz`` and its ``LICENSE``, it
writes the groups of calibrations and how much lenses of one kind differ into ``src/vfm_sdm/inputs/profiles``, and their
checksums into ``table.py`` there.
"""

import argparse
import csv
import gzip
import hashlib
import io
import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from lens_records import GROUP, group_records, read_records
from lens_scatter import fit_all

from vfm_sdm.inputs.profiles.table import SCATTER, TABLE

HERE = Path(__file__).resolve().parents[1] / "src" / "vfm_sdm" / "inputs" / "profiles"


def main(arguments: Sequence[str] | None = None) -> int:
    """Writes the files of the package from a folder of calibrations."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args(arguments).folder
    records = read_records(folder / "lens_profiles.csv.gz")
    rows = group_records(records)
    text = io.StringIO(newline="")
    columns = ["name", *GROUP, *(name for name in rows[0] if name not in ("name", *GROUP))]
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    scatter = fit_all(records)
    (HERE / TABLE).write_bytes(gzip.compress(text.getvalue().encode("utf-8"), 9, mtime=0))
    (HERE / SCATTER).write_text(json.dumps(scatter, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    (HERE / "LICENSE-profiles").write_bytes((folder / "LICENSE").read_bytes())
    size = (HERE / TABLE).stat().st_size
    sys.stdout.write(f"{len(records)} calibrations in {len(rows)} groups, {size / 1e3:.0f} kB\n")
    module = (HERE / "table.py").read_text(encoding="utf-8")
    for name, word in ((TABLE, "TABLE"), (SCATTER, "SCATTER")):
        checksum = hashlib.sha256((HERE / name).read_bytes()).hexdigest()
        module = re.sub(rf'    {word}: "[0-9a-f]*",', f'    {word}: "{checksum}",', module)
    (HERE / "table.py").write_text(module, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
