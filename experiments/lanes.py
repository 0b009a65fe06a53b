"""vmap with the members along the last axis of every array, inside loops too: a member is a lane of the SIMD unit.

`jax.vmap` puts members first. The arrays of one robot are tiny (3, 4 x 3, 6 x 6), so the innermost loop of a compiled
kernel then runs over three numbers; with members last it runs over members and is vectorised whole.

The function is traced once for one member; its equations are then bound again with one more axis at the end.
Primitives without a rule here go through `jax.vmap`.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
from jax import lax
from jax.extend import core


class Lane(NamedTuple):
    """A value of the traced function; with members it has one more axis, the last."""

    value: Any
    members: bool


def lanes(function: Callable[..., Any]) -> Callable[[Any, Any], Any]:
    """`function(shared, member) -> output` over members; arguments and outputs have the member axis first."""

    def run(shared: Any, members: Any) -> Any:
        leaves, form = jax.tree.flatten(members)
        one = jax.tree.unflatten(form, [jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for x in leaves])
        closed, shape = jax.make_jaxpr(function, return_shape=True)(shared, one)
        size = len(leaves[0])
        arguments = [Lane(x, False) for x in jax.tree.leaves(shared)]
        arguments += [Lane(jax.numpy.moveaxis(x, 0, -1), True) for x in leaves]
        found = [jax.numpy.moveaxis(_wide(x, size), -1, 0) for x in _run(closed, arguments, size)]
        return jax.tree.unflatten(jax.tree.structure(shape), found)

    return run


def _run(closed: core.ClosedJaxpr, arguments: Sequence[Lane], size: int) -> list[Lane]:
    """The outputs of a traced function for arguments of which some have members."""
    jaxpr = closed.jaxpr
    known: dict[Any, Lane] = dict(zip(jaxpr.constvars, (Lane(x, False) for x in closed.consts), strict=True))
    known |= dict(zip(jaxpr.invars, arguments, strict=True))

    def read(atom: Any) -> Lane:
        return Lane(atom.val, False) if isinstance(atom, core.Literal) else known[atom]

    for equation in jaxpr.eqns:
        inputs = [read(atom) for atom in equation.invars]
        known |= dict(zip(equation.outvars, _bind(equation, inputs, size), strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def _bind(equation: core.JaxprEqn, inputs: list[Lane], size: int) -> list[Lane]:
    """The outputs of one equation."""
    name, params = equation.primitive.name, equation.params
    inner = params.get("jaxpr") or params.get("call_jaxpr")
    if name == "scan" and any(x.members for x in inputs):
        return _scan(params, inputs, size)
    if inner is not None and name in CALLS:
        return _run(inner, inputs, size)
    found = _new_axis(equation, inputs, size) if any(x.members for x in inputs) else _as_traced(equation, inputs)
    return [Lane(x, any(x.members for x in inputs)) for x in found]


def _as_traced(equation: core.JaxprEqn, inputs: list[Lane]) -> Sequence[Any]:
    values = [x.value for x in inputs]
    found = equation.primitive.bind(*values, **equation.primitive.get_bind_params(equation.params))
    return found if equation.primitive.multiple_results else [found]


def _new_axis(equation: core.JaxprEqn, inputs: list[Lane], size: int) -> Sequence[Any]:
    """One equation with members, by the rule of its primitive or by `jax.vmap`."""
    primitive, name, params = equation.primitive, equation.primitive.name, equation.params
    rank = len(equation.outvars[0].aval.shape)
    if name in ELEMENTWISE:
        shape, alike = equation.outvars[0].aval.shape, name == "select_n"
        return [primitive.bind(*(_fitted(x, shape, size, alike) for x in inputs), **params)]
    only_first = inputs[0].members and not any(x.members for x in inputs[1:])
    if name in SAME_AXES:
        found = primitive.bind(*(_wide(x, size) for x in inputs), **params)
        return found if primitive.multiple_results else [found]
    if name in MORE_AXES and only_first:
        values = [x.value for x in inputs]
        return [MORE_AXES[name](values, params, rank, size)]
    places = [-1 if x.members else None for x in inputs]
    call = jax.vmap(lambda *values: _as_traced(equation, [Lane(v, False) for v in values]), places, -1, axis_size=size)
    return call(*(x.value for x in inputs))


def _fitted(x: Lane, shape: tuple[int, ...], size: int, alike: bool) -> Any:
    """An operand of an elementwise primitive of this shape: scalars without members stay so if need not be alike."""
    rank = jax.numpy.ndim(x.value) - x.members
    if not x.members and rank == 0 and not alike:
        return x.value
    return lax.broadcast_in_dim(
        x.value, (*shape, size), (*range(len(shape) - rank, len(shape)), *(len(shape),) * x.members)
    )


def _wide(x: Lane, size: int) -> Any:
    """The value with members, copied to all if it had none."""
    if x.members:
        return x.value
    shape = jax.numpy.shape(x.value)
    return lax.broadcast_in_dim(x.value, (*shape, size), tuple(range(len(shape))))


def _scan(params: dict[str, Any], inputs: list[Lane], size: int) -> list[Lane]:
    """A loop whose whole carry has members; what it only reads keeps what it is."""
    first, last = params["num_consts"], params["num_consts"] + params["num_carry"]
    constants, start, rows = inputs[:first], inputs[first:last], inputs[last:]

    def body(carry: list[Any], row: list[Any]) -> tuple[list[Any], list[Any]]:
        carried = [Lane(x, True) for x in carry]
        here = [Lane(x, lane.members) for x, lane in zip(row, rows, strict=True)]
        found = [_wide(x, size) for x in _run(params["jaxpr"], [*constants, *carried, *here], size)]
        return found[: len(start)], found[len(start) :]

    carry, kept = lax.scan(
        body,
        [_wide(x, size) for x in start],
        [x.value for x in rows],
        params["length"],
        params["reverse"],
        params["unroll"],
    )
    return [Lane(x, True) for x in [*carry, *kept]]


def _broadcast(values, params, rank, size):
    return lax.broadcast_in_dim(
        values[0], (*params["shape"], size), (*params["broadcast_dimensions"], len(params["shape"]))
    )


def _slice(values, params, rank, size):
    strides = params["strides"]
    return lax.slice(
        values[0],
        (*params["start_indices"], 0),
        (*params["limit_indices"], size),
        None if strides is None else (*strides, 1),
    )


def _dynamic_slice(values, params, rank, size):
    return lax.dynamic_slice(values[0], (*values[1:], 0), (*params["slice_sizes"], size))


CALLS = {"jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "checkpoint", "remat"}
ELEMENTWISE = set(
    """abs acos add and asin atan atan2 ceil clamp convert_element_type cos div eq erf exp exp2 expm1 floor ge gt
    integer_pow is_finite le log log1p logistic lt max min mul ne neg nextafter not or pow rem round rsqrt select_n
    sign sin sqrt square sub tan tanh xor""".split()
)
SAME_AXES = set(
    """argmax argmin concatenate copy cummax cummin cumsum optimization_barrier reduce_and reduce_max reduce_min
    reduce_or reduce_sum rev split squeeze stack stop_gradient unstack""".split()
)
MORE_AXES: dict[str, Callable[..., Any]] = {
    "broadcast_in_dim": _broadcast,
    "dynamic_slice": _dynamic_slice,
    "reshape": lambda values, params, rank, size: lax.reshape(values[0], (*params["new_sizes"], size)),
    "slice": _slice,
    "transpose": lambda values, params, rank, size: lax.transpose(values[0], (*params["permutation"], rank)),
}
