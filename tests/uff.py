"""Universal files read back, by the columns of the format's description and by nothing of this package."""

from pathlib import Path

import numpy as np


def read_uff(path: Path) -> tuple[list[str], list[dict]]:
    """An independent reader by the columns of the format's description."""
    lines = path.read_text(encoding="ascii").splitlines()
    assert lines[0] == "    -1"
    blocks: list[list[str]] = []
    inside = False
    for line in lines:
        if line == "    -1":
            inside = not inside
            if inside:
                blocks.append([])
        else:
            assert inside
            blocks[-1].append(line)
    assert not inside
    functions = []
    for block in blocks:
        assert max(map(len, block)) <= 80
        if block[0] != "    58":
            continue
        dof, form = block[6], block[7]
        count, even = int(form[10:20]), int(form[20:30])
        values = "".join(block[12:])
        if even:
            numbers = np.array([float(values[i : i + 20]) for i in range(0, 20 * count, 20)])
            times = float(form[30:43]) + float(form[43:56]) * np.arange(count)
        else:
            times = np.array([float(values[i : i + 13]) for i in range(0, 33 * count, 33)])
            numbers = np.array([float(values[i + 13 : i + 33]) for i in range(0, 33 * count, 33)])
        assert len(values) == count * (20 if even else 33)
        functions.append(
            {
                "ids": block[1:6],
                "type": int(dof[:5]),
                "node": int(dof[41:51]),
                "direction": int(dof[51:55]),
                "ordinate_type": int(form[:10]),
                "abscissa": (int(block[8][:10]), block[8][26:46].strip(), block[8][47:67].strip()),
                "ordinate": (
                    int(block[9][:10]),
                    int(block[9][10:15]),
                    block[9][26:46].strip(),
                    block[9][47:67].strip(),
                ),
                "even": even,
                "times": times,
                "values": numbers,
            }
        )
    return blocks[0], functions
