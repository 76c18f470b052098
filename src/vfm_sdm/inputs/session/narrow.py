"""A part of a session: the fields that a stage declares to read, everything else at its default.

A stage that is given the narrowed session cannot read what it did not declare, so that a key made of the narrowed
fields leaves nothing out.
"""

from collections.abc import Sequence
from typing import Any, TypeVar

from pydantic import BaseModel

__all__ = ["narrow"]

M = TypeVar("M", bound=BaseModel)


def narrow(model: M, reads: Sequence[str], *, always: Sequence[str] = ()) -> M:
    """The model with the named fields alone.

    Parameters
    ----------
    model
        A session, or a table of it.
    reads
        Dotted names of fields, such as ``site`` or ``view.lens``; of a list of tables, the field of every table.
        ``*`` stands for all.
    always
        Names of fields that stay in any case.

    Raises
    ------
    ValueError
        There is no such field.

    Notes
    -----
    Fields that are required and not named are ``None``; lists of tables none of whose fields is named are empty.
    """
    if "*" in reads:
        return model
    known, tables = type(model).model_fields, model.model_extra or {}
    unknown = {name.split(".")[0] for name in reads} - {*known, *tables}
    if unknown:
        raise ValueError(
            f"reads: expected fields of {sorted([*known, *tables])}, got {sorted(unknown)}; correct the declaration"
        )
    values: dict[str, Any] = {}
    for name, field in known.items():
        value = getattr(model, name)
        inner = [read.removeprefix(f"{name}.") for read in reads if read.startswith(f"{name}.")]
        if name in reads or name in always:
            values[name] = value
        elif inner and isinstance(value, BaseModel):
            values[name] = narrow(value, inner)
        elif inner and isinstance(value, tuple):
            values[name] = tuple(narrow(one, inner) if isinstance(one, BaseModel) else one for one in value)
        elif field.is_required():
            values[name] = () if isinstance(value, tuple) else None
        else:
            values[name] = field.get_default(call_default_factory=True, validated_data={})
    values |= {name: table for name, table in tables.items() if name in reads}
    return type(model).model_construct(**values)
