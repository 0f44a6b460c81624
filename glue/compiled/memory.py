"""Memory in compiled code: what is needed soon, references that are not counted, and bytes to be copied."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any, Final, TypeVar

from numba.core import cgutils, config, types
from numba.extending import intrinsic

Held = TypeVar("Held")

_LINE: Final = 64
"""Bytes of a cache line."""

if config.DISABLE_JIT:  # type: ignore[attr-defined]

    def uncounted(array: Held) -> Held:
        """Return `array`."""
        return array

    def prefetch(array: Any, byte: int, lines: int) -> None:
        """Do nothing."""

    def copy_bytes(target: int, source: int, count: int) -> None:
        """Copy `count` bytes from one address to another."""
        ctypes.memmove(int(target), int(source), int(count))

else:
    copy_bytes = types.ExternalFunction("memcpy", types.uintp(*[types.uintp] * 3))  # type: ignore[assignment]

    @intrinsic
    def uncounted(typing: Any, array: Any) -> Any:
        """Return `array` without its owner, which must outlive it.

        Otherwise threads that take rows of one array take turns at its count of references.
        """

        def generate(context: Any, builder: Any, signature: Any, arguments: Sequence[Any]) -> Any:
            made = context.make_array(array)(context, builder, arguments[0])
            made.meminfo = cgutils.get_null_value(made.meminfo.type)  # type: ignore[no-untyped-call]
            return made._getvalue()

        return array(array), generate

    @intrinsic(prefer_literal=True)
    def prefetch(typing: Any, array: Any, byte: Any, lines: Any) -> Any:
        """Ask for cache lines, from a byte of `array` on, or before it; the number of lines is constant."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Sequence[Any]) -> Any:
            data = context.make_array(array)(context, builder, arguments[0]).data
            pointer, number = cgutils.voidptr_t, cgutils.int32_t
            ir: Any = cgutils.ir  # type: ignore[attr-defined]
            form = ir.FunctionType(ir.VoidType(), [pointer, number, number, number])
            ask = builder.module.declare_intrinsic("llvm.prefetch", [pointer], form)
            first = builder.gep(builder.bitcast(data, pointer), [arguments[1]])
            for line in range(lines.literal_value):
                # To write to; into the nearest cache; data.
                at = builder.gep(first, [number(_LINE * line)])
                builder.call(ask, [at, number(1), number(3), number(1)])
            return context.get_dummy_value()

        return types.none(array, types.int64, lines), generate
