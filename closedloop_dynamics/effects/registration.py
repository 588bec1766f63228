# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Registration of users' own effects."""

from dataclasses import is_dataclass

from .registry import EFFECTS
from .traced_effect import TracedEffect
from ..mechanism.checks import name as name_check
from ..mechanism.fields import at, FieldError, shown

of_users = set()


def register(name, record_type):
    """
    Register an effect of a user's own, so that scenes may name it.

    Parameters
    ----------
    name : str
        For ``type``.
    record_type : type
        A frozen dataclass derived from ``TracedEffect``. One that had the name before goes, unless
        it is one of the package.

    Raises
    ------
    FieldError
        Where it is not such a class, or the name is not free.

    """
    with at('type'):
        name_check(name)
        if not (isinstance(record_type, type) and issubclass(record_type, TracedEffect)
                and is_dataclass(record_type)):
            raise FieldError('a dataclass derived from TracedEffect', shown(record_type))
        if name in EFFECTS and name not in of_users:
            raise FieldError('a name that no effect of the package has', shown(name))
    of_users.add(name)
    EFFECTS[name] = record_type
