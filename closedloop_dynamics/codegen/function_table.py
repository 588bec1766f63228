# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Function tables: addresses of the routines and arrays of one mechanism, for the engine.

A function table is an array of integers: the addresses of the routines, zero for those that are
not there, then those of the arrays that they work on. A routine is called with the table and a
state, and returns whether its results are good; the places of the routines are those of
``engine/columns.hpp``. Where effects are listed, the evaluation is that of the scene, with their
laws (``live_scene``), or there is none.
"""

import numpy as np

(
    # Addresses of routines: of a state the accelerations and multipliers; the outward recursion
    # alone, and what follows it; the corrections that close the loops; the latter two with
    # refinement. After them the forces in joints, or the wrenches; before that, where equations
    # are left out, the multipliers of all. Of a scene also the evaluation where a joint under dry
    # friction is at rest, and that without the friction of all that are, with the response to
    # each. Last the closure equations alone, for places around a singular position, whether
    # accelerations fulfil the equations that are left out, of a scene its energies, what torques
    # add to the accelerations and multipliers of the latest evaluation in parts, for the branch at
    # a singular position the equations of motion of the trees alone, and the accelerations of a
    # state for a step, without multipliers and closure errors, where none of these decays.
    EVALUATION, OUTWARD, ACCELERATION, CORRECTION, REFINED_ACCELERATION, REFINED_CORRECTION,
    REACTIONS, WRENCHES, LEAST_FORCES, AT_REST, RESPONSES, LOOP_EQUATIONS,
    LEFT_OUT, ENERGIES, TORQUE_RESPONSE, EQUATIONS_OF_MOTION, MOTION,
    # Addresses of arrays; the last ones are of effects (``engine/effect_table.hpp``).
    BODY, GRAVITY, CUT_POINT, TAU, BAUMGARTE, QDD, LAM, HEALTH, WORK_BODY, CLOSURE, CLOSURE_RATE,
    CORRECTIONS, REACTION, COMMAND, VALUES, ENTRIES, CUT_VALUES, PRESENT, SIDES, GAPS, TRIALS,
    RATES,
    # Addresses of functions of the engine (``engine/library.hpp``).
    PIECE, NEAREST, FURTHEST,
    # Addresses of the arrays that the routines of forces read and write.
    WRENCH, JOINT_POINT, LAM_OF_ALL,
    # Addresses that the engine fills in: further outputs of LOOP_EQUATIONS beside CLOSURE; the
    # outputs of EQUATIONS_OF_MOTION, and the forces on bodies that it adds to those of their
    # motion.
    BIAS, JACOBIAN, INERTIA_MATRIX, JOINT_FORCE, ADDED_FORCE,
    # Address of results of ENERGIES.
    ENERGY,
    # Addresses of outputs of RESPONSES: accelerations and multipliers by each friction
    # (``StaticFriction``), and its limit, zero where the joint slides.
    RESPONSE, LIMIT,
    # Address of what ACCELERATION keeps for TORQUE_RESPONSE; of code for a system: how many
    # numbers.
    FACTORS, TABLE_COLUMNS) = range(55)
ALWAYS = (OUTWARD, ACCELERATION, CORRECTION)
REFINED = (REFINED_ACCELERATION, REFINED_CORRECTION)
OF_FORCES = (WRENCHES, LEAST_FORCES, LEFT_OUT)
OF_BRANCHES = (LOOP_EQUATIONS, EQUATIONS_OF_MOTION)
OF_SCENE = (EVALUATION, MOTION, AT_REST, RESPONSES)
FUNCTIONS = (PIECE, NEAREST, FURTHEST)


def behind(last, count):
    """Return the places that tables have behind the last one of others: so many."""
    return range(last + 1, last + 1 + count)


# What the routine of one law (``law_routine``) has in the table of its row beside these arrays, of
# which TAU and COMMAND are those of its joints: its states, its row of ``EffectTable.output``, how
# many entries it has, and of a motion what its closure equation is to have. Behind are the rows of
# its bodies.
STATES, OUTPUT, COUNT, RIGHT_SIDE, LAW_COLUMNS = behind(FACTORS, 5)
# Addresses in the table of routines for the derivatives of steps (``sensitivities``): inputs and
# outputs; and results of one routine that another one of the same table works on, for all its
# lanes.
SEED, RESULT, SHARED, STEP_COLUMNS = behind(FACTORS, 4)
# Numbers of a row of VALUES and of PRESENT (``engine/effect_table.hpp``).
VALUE_COLUMNS, PRESENT_COLUMNS = 13, 12
# States side by side in the vectors of ``lanes``: one of AVX-512, two of AVX2, four of NEON.
LANES = 8
# States of one mechanism side by side: places around a singular position.
PLACES = 4


def connect(arrays):
    """
    Return a function table without routines.

    ``arrays``, by the places BODY to LAM_OF_ALL, are not kept by the table.
    """
    table = np.zeros(TABLE_COLUMNS, dtype=np.int64)
    for place, array in arrays.items():
        table[place] = array.ctypes.data
    return table
