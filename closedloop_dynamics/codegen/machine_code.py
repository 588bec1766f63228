# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Machine code of routines, by LLVM, or as an earlier process left it on disk.

LLVM is loaded when it is needed, not with the package: that takes longer than the rest. Where it
is not installed the C compiler of the system serves (``c_code``).
"""

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
import functools
import hashlib
from importlib import import_module
from threading import Lock

from . import c_code, cache

# How routines are written: module and class.
SCALAR, ROW, KERNEL, LANES, PLACES, PACKED = (
    ('.emit', 'Writer'), ('.emit', 'RowWriter'), ('.emit', 'KernelWriter'),
    ('.lane_writer', 'LaneWriter'),
    ('.lane_writer', 'PlaceWriter'), ('.packed_writer', 'PackedWriter'))
# Passes of higher levels take time and make this code no faster: it has no loops.
OPTIMISATION = 1
# Operations that are compiled in a second; what takes less than LONG [s] is not announced.
A_SECOND, LONG = 7000, 4.0
# Functions to machine code in use, by its digest: it must stay where it is as long as the process
# lives, and is there once, however many ask for it.
engines = {}
_announce = []
# LLVM's options are those of the whole process.
_compiling = Lock()


@contextmanager
def announced_by(announce):
    """Announce long compilations, before they begin, by a function that takes a sentence."""
    _announce.append(announce)
    try:
        yield
    finally:
        _announce.remove(announce)


def machine_code(key, routines, form, parts=1):
    """
    Return a function from a routine's name to its address, compiled now or by an earlier process.

    ``key``: structure of the mechanism and all else that the routines depend on; ``routines``
    returns the list of Routine, called only where nothing is stored; ``form``: ``SCALAR``,
    ``ROW``, ``KERNEL``, ``LANES``, ``PLACES`` or ``PACKED``; ``parts``: of how many objects the
    code is, at most as many as there are routines.
    """
    host, compiled, loaded = (c_code.host, c_code.compiled, c_code.loaded) if (
        cache.LLVM is None) else (_host, _compiled, _loaded)
    digest = hashlib.sha256(repr((key, form, *host())).encode()).hexdigest()[:32]
    if digest in engines:
        return engines[digest]
    names = [f'codegen.{digest}.{part}.o' for part in range(parts)]
    objects = [cache.read(name) for name in names]
    if None in objects:
        traced = routines()
        seconds = sum(len(one.needed()) for one in traced) / A_SECOND if _announce else 0.0
        for announce in _announce if seconds >= LONG else ():
            announce(f'generating code for this mechanism, which may take {seconds:.0f} s; '
                     'it is kept for the next start')
        objects = compiled(traced, form, parts)
        for name, code in zip(names, objects):
            cache.write(name, code)
    return engines.setdefault(digest, loaded(objects))


def _loaded(objects):
    """Load objects for good; return a function from a routine's name to its address."""
    from llvmlite import binding
    # An engine needs a module to start from; the code itself is added as objects.
    engine = binding.create_mcjit_compiler(binding.parse_assembly(''), _machine(binding))
    for code in objects:
        engine.add_object_file(binding.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine.get_function_address


@functools.cache
def _host():
    """Return the names of this computer's processor and of its features, for LLVM made ready."""
    from llvmlite import binding
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()


def _machine(binding):
    """Return LLVM's target machine for this computer."""
    cpu, features = _host()
    return binding.Target.from_default_triple().create_target_machine(
        cpu=cpu, features=features, opt=OPTIMISATION)


def _compiled(routines, form, parts):
    """Return the objects of routines; while LLVM compiles one, the next one is written."""
    place, writer = form
    emit = import_module('.emit', __package__)
    writer = getattr(import_module(place, __package__), writer)
    with ThreadPoolExecutor(1) as others:
        waiting = [others.submit(_object, *emit.intermediate_code(routines[part::parts], writer))
                   for part in range(parts)]
        return [one.result() for one in waiting]


def _object(code, ordered):
    """Compile a module of its own; ``ordered``: whether instructions are to stay in order."""
    from llvmlite import binding
    machine = _machine(binding)
    parsed = binding.parse_assembly(code, binding.create_context())
    parsed.triple = machine.triple
    parsed.verify()
    with _compiling:
        binding.set_option('', f'-enable-misched={int(not ordered)}')
        return machine.emit_object(parsed)
