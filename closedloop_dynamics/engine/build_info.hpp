// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

/// @file
/// Sources, compiler and options of this binary.

#pragma once

namespace closedloop {

/// Digest of the sources; build.py computes the same from the files.
extern const char *const sources;
/// Name and version of the compiler.
extern const char *const compiler;
/// Flags that the compiler was given.
extern const char *const flags;

}  // namespace closedloop
