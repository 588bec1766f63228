# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Print constraints for pip that keep what is installed already.

Used on top of a ROS installation, whose packages fit each other: with plain pins pip would put a
second copy of many of them in front. A package that is installed in another version than the pin
may have any version between the two; pip then keeps the installed one, unless something needs a
newer one.
"""

from importlib.metadata import distributions
from pathlib import Path
import sys

from pip._vendor.packaging.requirements import Requirement
from pip._vendor.packaging.utils import canonicalize_name
from pip._vendor.packaging.version import Version


def pins(path):
    """Yield the requirements of a constraints file and of those it includes."""
    for line in path.read_text().splitlines():
        if line.startswith('-c '):
            yield from pins(path.parent / line.removeprefix('-c ').strip())
        elif line and not line.startswith('#'):
            yield Requirement(line)


def relaxed(pin, installed):
    """Return the pin, widened to include the installed version."""
    versions = sorted([Version(installed), *(Version(spec.version) for spec in pin.specifier)])
    return f'{pin.name}>={versions[0]},<={versions[-1]}'


def main():
    installed = {}
    for found in distributions():
        # The first one on the path is the one that is imported.
        installed.setdefault(canonicalize_name(found.name), found.version)
    for pin in pins(Path(sys.argv[1])):
        version = installed.get(canonicalize_name(pin.name))
        print(pin if version is None else relaxed(pin, version))


if __name__ == '__main__':
    main()
