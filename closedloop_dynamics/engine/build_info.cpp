// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "build_info.hpp"

namespace closedloop {

const char *const sources = ENGINE_SOURCES;
#ifdef __clang__
const char *const compiler = __VERSION__;
#else
const char *const compiler = "GCC " __VERSION__;
#endif
const char *const flags = ENGINE_FLAGS;

}  // namespace closedloop
