"""Names of the teachers of a guide. Loads nothing, so that the command line can list them."""

from __future__ import annotations

from typing import Literal, get_args

TeacherName = Literal["backup", "exact", "dqn"]
TEACHERS: tuple[TeacherName, ...] = get_args(TeacherName)
