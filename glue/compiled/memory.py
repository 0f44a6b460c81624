"""Memory in compiled code: what is needed soon, references that are not counted, and bytes to be copied."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any, TypeVar

from numba.core import cgutils, config, types
from numba.extending import intrinsic

Held = TypeVar("Held")

if config.DISABLE_JIT:  # type: ignore[attr-defined]

    def uncounted(array: Held) -> Held:
        """Return `array`."""
        return array

    def prefetch(address: int) -> None:
        """Do nothing."""

    def copy_bytes(target: int, source: int, count: int) -> None:
        """Copy `count` bytes between two addresses."""
        ctypes.memmove(int(target), int(source), int(count))

else:
    _form = types.uintp(types.uintp, types.uintp, types.uintp)
    copy_bytes = types.ExternalFunction("memcpy", _form)  # type: ignore[assignment]

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

    @intrinsic
    def prefetch(typing: Any, address: Any) -> Any:
        """Ask for a cache line that is needed soon; there need not be one."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Sequence[Any]) -> Any:
            byte, number = cgutils.voidptr_t, cgutils.int32_t
            ir: Any = cgutils.ir  # type: ignore[attr-defined]
            form = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
            ask = builder.module.declare_intrinsic("llvm.prefetch", [byte], form)
            # To write to; into the nearest cache; data.
            builder.call(ask, [builder.inttoptr(arguments[0], byte), number(1), number(3), number(1)])
            return context.get_dummy_value()

        return types.none(types.uintp), generate
