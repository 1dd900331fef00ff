"""How every kernel is compiled."""

from __future__ import annotations

from typing import Any

from numba import njit

# Without numba's reference counting: counting the arrays of a pack at every call costs more than the physics (measured:
# 232 against 31 ns per node and evaluation), and a kernel that allocates then does not compile, so that no march can.
# Division by zero gives inf or NaN, which a march ends with a Status, not an exception: a run that diverges may fold a
# joint by exactly half a turn.
NO_COUNTING: Any = {"_nrt": False, "error_model": "numpy"}
kernel: Any = njit(cache=True, **NO_COUNTING)

# For kernels called once per element with a pack of many arrays: passing it costs more than the work.
inlined: Any = njit(cache=True, inline="always", **NO_COUNTING)
