# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The step of a model over a period as an operator of PyTorch, on the memory of its tensors."""

import ctypes
from itertools import count
from weakref import WeakValueDictionary

from .callable_steps import CallableSteps, failure
from ..mechanism.extras import of_an_extra

with of_an_extra():
    import torch

_Rows = ctypes.CFUNCTYPE(
    ctypes.c_int64, ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p)
# Steps by the numbers that operators know them by.
_steps, _numbers = WeakValueDictionary(), count()


def torch_step(model, period, method='rk4', steps=None):
    """
    Return the step of a model over a period, torques held, as a function of PyTorch.

    Parameters
    ----------
    model : Model
        All of whose effects have derivatives.
    period, method, steps
        As for ``Stepper``.

    Returns
    -------
    callable
        Of coordinates, shape (nq,), that close the loops, rates, shape (nv,), and torques of the
        actuated joints, shape (na,), tensors of float64 on the CPU; returns coordinates and rates
        after the period. With leading axes, the same in all three, the states of a batch are
        advanced in one call of the engine. It has first derivatives in reverse, for ``backward``
        and ``torch.func.grad``, and goes through ``torch.func.vmap`` and ``torch.compile``; they
        are those of the arithmetic of the steps, by single coordinates, as of ``Sensitivity``.

    Raises
    ------
    SimulationError, ValueError
        As ``Stepper`` does; calls raise its errors, with the number of the state.

    """
    of, number = CallableSteps(model, period, method, steps), next(_numbers)
    _steps[number] = of

    def step(q, qd, torque):
        for name, one, length in zip(('q', 'qd', 'torque'), (q, qd, torque), of.shapes):
            if one.shape != (*q.shape[:-1], length) or one.dtype != torch.float64 or (
                    one.device.type != 'cpu'):
                raise ValueError(
                    f'{name}: expected float64 of shape {(*q.shape[:-1], length)} on the CPU, '
                    f'got {one.dtype} of shape {tuple(one.shape)} on {one.device}')
        return _Step.apply(q, qd, torque, number)

    # The number means something as long as it is there.
    step.steps = of
    return step


def _called(address, of, given, lengths):
    """Return the results of a function of rows."""
    lead = given[0].shape[:-1]
    given = [one.contiguous() for one in given]
    found = [one.new_empty((*lead, length)) for one, length in zip(given, lengths)]
    pointers = [(ctypes.c_void_p * len(some))(*(one.data_ptr() for one in some))
                for some in (given, found)]
    code = _Rows(address)(of.address, lead.numel(), *pointers)
    if code:
        raise failure(code)
    return tuple(found)


@torch.library.custom_op('closedloop_dynamics::step', mutates_args=())
def _step(q: torch.Tensor, qd: torch.Tensor, torque: torch.Tensor,
          number: int) -> tuple[torch.Tensor, torch.Tensor]:
    of = _steps[number]
    return _called(of.step, of, (q, qd, torque), of.shapes[:2])


@torch.library.custom_op('closedloop_dynamics::step_weights', mutates_args=())
def _weights(q: torch.Tensor, qd: torch.Tensor, torque: torch.Tensor, of_q: torch.Tensor,
             of_qd: torch.Tensor, number: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    of = _steps[number]
    return _called(of.weight, of, (q, qd, torque, of_q, of_qd), of.shapes)


def _in_batches(function, info, axes, *given):
    """Hand a batch of ``torch.func.vmap`` to a function of rows."""
    rows = [one if not isinstance(one, torch.Tensor) else
            one.expand(info.batch_size, *one.shape) if axis is None else one.movedim(axis, 0)
            for one, axis in zip(given, axes)]
    found = function.apply(*rows)
    return found, tuple(0 for _ in found)


class _Step(torch.autograd.Function):
    """The operator, with derivatives that ``torch.func`` knows, too."""

    @staticmethod
    def forward(q, qd, torque, number):
        return _step(q, qd, torque, number)

    @staticmethod
    def setup_context(ctx, inputs, output):
        ctx.save_for_backward(*inputs[:3])
        ctx.number = inputs[3]

    @staticmethod
    def backward(ctx, of_q, of_qd):
        return (*_Weights.apply(*ctx.saved_tensors, of_q, of_qd, ctx.number), None)

    @staticmethod
    def vmap(info, axes, *given):
        return _in_batches(_Step, info, axes, *given)


class _Weights(torch.autograd.Function):
    """Its derivatives, which have none themselves."""

    @staticmethod
    def forward(*given):
        return _weights(*given)

    @staticmethod
    def setup_context(ctx, inputs, output):
        ctx.number = inputs[-1]

    @staticmethod
    def backward(ctx, *_):
        raise NotImplementedError(f'{_steps[ctx.number]!r} has first derivatives alone')

    @staticmethod
    def vmap(info, axes, *given):
        return _in_batches(_Weights, info, axes, *given)


_step.register_fake(lambda q, qd, torque, number: (torch.empty_like(q), torch.empty_like(qd)))
_weights.register_fake(lambda q, qd, torque, of_q, of_qd, number: tuple(
    map(torch.empty_like, (q, qd, torque))))
