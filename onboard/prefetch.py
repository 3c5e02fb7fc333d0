"""Ask the processor for memory that compiled code reads a little later: what lies about the next star, or along the next line.

A star or a line touches a new row of a 16-Mpx image at every step, each far from the last. The processor waits for each of them,
unless it was told. Nothing that is computed changes.
"""

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

READ, KEEP, DATA = 0, 3, 1
"""Arguments of LLVM's intrinsic: the memory will be read, stays in all caches, and is no code."""


def _ask_for(typing_context: Any, array: Any, place: Any) -> Any:  # noqa: ARG001 - the signature is Numba's
    """Signature and code of `ask_for`; None for other arguments, as Numba wants it."""
    if not (isinstance(array, types.Array) and isinstance(place, types.UniTuple) and array.ndim == place.count):
        return None

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        given = context.make_array(signature.args[0])(context, builder, arguments[0])
        byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        prefetch = builder.module.declare_intrinsic("llvm.prefetch", (byte,), kind)
        address = builder.bitcast(given.data, byte)
        for index, stride in zip(
            cgutils.unpack_tuple(builder, arguments[1]), cgutils.unpack_tuple(builder, given.strides), strict=True
        ):
            address = builder.gep(address, [builder.mul(index, stride)])
        builder.call(prefetch, [address, number(READ), number(KEEP), number(DATA)])
        return context.get_dummy_value()

    return types.void(array, types.UniTuple(types.intp, array.ndim)), code


ask_for: Any = intrinsic(_ask_for)
"""`ask_for(array, place)` in compiled code: bring an element of an array, and what lies beside it, into the cache.

place : its indices, a tuple of as many integers as the array has axes; outside of the array it does no harm.
"""
