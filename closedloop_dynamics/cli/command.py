# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""What a sub-command is, and what the options of all of them share."""

from argparse import ArgumentParser, ArgumentTypeError, RawDescriptionHelpFormatter
from dataclasses import dataclass
import math
import sys
from typing import Callable


class UsageError(ValueError):
    """A command line that makes no sense; the message says what would."""


@dataclass(frozen=True)
class Command:
    """
    One sub-command.

    Attributes
    ----------
    name : str
    summary : str
        For the list of commands, in a few words.
    description, epilog : str
        For its own help, before and after the options.
    add_arguments : callable
        Takes the command's parser.
    run : callable
        Takes the parsed arguments, returns the exit code; prints its result. It may raise
        UsageError, SceneError, MechanismError (exit code 2), SimulationError and OSError (1).

    """

    name: str
    summary: str
    description: str
    add_arguments: Callable
    run: Callable
    epilog: str = ''


class HelpfulParser(ArgumentParser):
    """A parser that keeps the line breaks of its texts, with errors in two lines."""

    def __init__(self, **options):
        """Build a parser; long options are never cut short, so that new ones break nothing."""
        super().__init__(
            formatter_class=RawDescriptionHelpFormatter, allow_abbrev=False, **options)

    def error(self, message):
        """Say what is wrong and where to read on; exit with 2."""
        print(f'{self.prog}: {message}\nTry: {self.prog} --help', file=sys.stderr)
        self.exit(2)


def positive(text):
    """Convert an option's value to a finite number > 0."""
    value = _number(text)
    if not 0.0 < value < math.inf:
        raise ArgumentTypeError(f'expected a finite number > 0, got {text!r}')
    return value


def assignment(text):
    """Convert ``NAME=NUMBER`` to a pair."""
    name, equals, value = text.partition('=')
    if not (name and equals and math.isfinite(_number(value))):
        raise ArgumentTypeError(f'expected NAME=NUMBER, got {text!r}')
    return name, float(value)


def mapping(pairs, option):
    """Return pairs of an option that may be repeated, each name once, as a dict."""
    result = dict(pairs)
    if len(result) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise UsageError(f'{option} {twice}: expected once, got it {names.count(twice)} times')
    return result


def _number(text):
    try:
        return float(text)
    except ValueError:
        return math.nan
