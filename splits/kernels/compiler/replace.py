"""Named tuples with some fields replaced, in kernels and in Python."""

from __future__ import annotations

from typing import Any

from numba.extending import overload

from splits.kernels.compiler.jit import INLINE_OPTIONS


def replace(value: Any, **changes: Any) -> Any:
    """Return a named tuple with some fields replaced, as `dataclasses.replace` does."""
    return value._replace(**changes)


@overload(replace, strict=False, jit_options=INLINE_OPTIONS)
def _replace_in_kernel(value: Any, **changes: Any) -> Any:
    # Numba has no keyword arguments of unknown names, so the function is written for these ones.
    kind = value.instance_class
    fields = (name if name in changes else f"value.{name}" for name in kind._fields)
    scope = {"Kind": kind}
    exec(
        f"def replace({', '.join(['value', *changes])}):\n    return Kind({', '.join(fields)})",
        scope,
    )
    return scope["replace"]
