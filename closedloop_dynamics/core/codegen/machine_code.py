# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Machine code of routines, by LLVM, or as an earlier process left it on disk.

LLVM is loaded when it is needed, not with the package: that takes longer than the rest.

"""

import hashlib
from importlib import import_module

from .. import cache

# How routines are written: module and class.
SCALAR, PIECE, LAW, LANES, PACKED = (
    ('.emit', 'Writer'), ('.emit', 'PieceWriter'), ('.emit', 'LawWriter'),
    ('.lane_writer', 'LaneWriter'), ('.packed_writer', 'PackedWriter'))
# Passes of higher levels take time and make this code no faster: it has no loops.
OPTIMISATION = 1
# Machine code in use: it must stay where it is as long as the process lives.
_engines = []


def machine_code(key, routines, form):
    """
    Return the addresses of routines, compiled now or by an earlier process.

    Parameters
    ----------
    key : tuple
        Structure of the mechanism and all else that the routines depend on.
    routines : callable
        Returns the list of Routine; called only where nothing is stored.
    form : tuple
        ``SCALAR``, ``PIECE``, ``LAW``, ``LANES`` or ``PACKED``.

    Returns
    -------
    callable
        From a routine's name to its address.

    """
    from llvmlite import binding
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    target = binding.Target.from_default_triple()
    cpu, features = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
    machine = target.create_target_machine(cpu=cpu, features=features, opt=OPTIMISATION)
    digest = hashlib.sha256(repr((key, form, cpu, features)).encode()).hexdigest()[:32]
    name = f'codegen.{digest}.o'
    # An engine needs a module to start from; the code itself is added as an object.
    engine = binding.create_mcjit_compiler(binding.parse_assembly(''), machine)
    code = cache.read(name)
    if code is None:
        place, writer = form
        emit = import_module('.emit', __package__)
        parsed = binding.parse_assembly(emit.intermediate_code(
            routines(), getattr(import_module(place, __package__), writer)))
        parsed.triple = target.triple
        parsed.verify()
        code = machine.emit_object(parsed)
        cache.write(name, code)
    engine.add_object_file(binding.ObjectFileRef.from_data(code))
    engine.finalize_object()
    _engines.append(engine)
    return engine.get_function_address
