"""Ask the processor for a pixel before it is needed.

Small windows at places of a list lie in cache lines that no processor foresees: half of the time of a fit went into waiting.
"""

from collections.abc import Callable
from typing import Any, Final, cast

from llvmlite import ir  # type: ignore[import-untyped] # comes with numba, without stubs
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

STARS_AHEAD: Final = 8
"""Pixels are asked for so many stars of a list before the one whose turn it is."""

READ, KEEP_CLOSE, DATA = 0, 3, 1
"""Arguments of LLVM's `llvm.prefetch`."""


def _typed(typing: Any, array: Any, row: Any, col: Any) -> Any:
    """Signature and code of `prefetch`."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pixels = context.make_array(signature.args[0])(context, builder, arguments[0])
        place = cgutils.get_item_pointer(context, builder, signature.args[0], pixels, arguments[1:], wraparound=False)
        byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        function_type = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        function = cgutils.get_or_insert_function(builder.module, function_type, "llvm.prefetch.p0")
        builder.call(function, [builder.bitcast(place, byte), *(ir.Constant(number, how) for how in (READ, KEEP_CLOSE, DATA))])
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp), code


prefetch: Final[Callable[[NDArray[Any], int, int], None]] = cast("Any", intrinsic(_typed))
"""``prefetch(array, row, col)`` in compiled code begins to load a pixel, which must lie in the array, into the cache."""
