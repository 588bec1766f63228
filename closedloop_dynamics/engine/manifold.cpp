// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "manifold.hpp"

#include <cmath>

namespace closedloop
{

namespace
{
enum : Index {QUATERNION, TURN};
// A rotation by d changes the components of a quaternion by d / 2.
constexpr double HALF = 0.5;

void rates_in_lane(
  const Manifold & manifold, Values state, Index nv, Values out, Index lanes, Index lane)
{
  const Index nq = nv + manifold.balls.rows;
  for (Index i = 0; i < nv; ++i) {
    if (manifold.place[i] >= 0) {
      out[lanes * manifold.place[i] + lane] = state[lanes * (nq + i) + lane];
    }
  }
  for (Index ball = 0; ball < manifold.balls.rows; ++ball) {
    const Index a = lanes * manifold.balls(ball, QUATERNION) + lane;
    const Index b = lanes * (nq + manifold.balls(ball, TURN)) + lane;
    const double x = state[a], y = state[a + lanes], z = state[a + 2 * lanes];
    const double w = state[a + 3 * lanes];
    const double p = HALF * state[b], q = HALF * state[b + lanes], r = HALF * state[b + 2 * lanes];
    out[a] = w * p + y * r - z * q;
    out[a + lanes] = w * q + z * p - x * r;
    out[a + 2 * lanes] = w * r + x * q - y * p;
    out[a + 3 * lanes] = -(x * p + y * q + z * r);
  }
}

void normalise_lane(const Manifold & manifold, Values q, Index lanes, Index lane)
{
  for (Index ball = 0; ball < manifold.balls.rows; ++ball) {
    const Index a = lanes * manifold.balls(ball, QUATERNION) + lane;
    const Index b = a + lanes, c = a + 2 * lanes, d = a + 3 * lanes;
    const double scale = 1.0 / std::sqrt(q[a] * q[a] + q[b] * q[b] + q[c] * q[c] + q[d] * q[d]);
    q[a] *= scale;
    q[b] *= scale;
    q[c] *= scale;
    q[d] *= scale;
  }
}
}  // namespace

void rates_of_coordinates(
  const Manifold & manifold, Values state, Index nv, Values out, Index lanes)
{
  if (manifold.empty()) {
    for (Index i = 0; i < lanes * nv; ++i) {
      out[i] = state[lanes * nv + i];
    }
    return;
  }
  for (Index lane = 0; lane < lanes; ++lane) {
    rates_in_lane(manifold, state, nv, out, lanes, lane);
  }
}

void power_of_turns(
  const Manifold & manifold, Values tau, Values state, Index nv, Values out, Index lanes)
{
  if (manifold.empty()) {
    return;
  }
  const Index nq = nv + manifold.balls.rows;
  for (Index lane = 0; lane < lanes; ++lane) {
    double power = 0.0;
    for (Index ball = 0; ball < manifold.balls.rows; ++ball) {
      const Index rate = manifold.balls(ball, TURN);
      for (Index k = rate; k < rate + 3; ++k) {
        power += tau[lanes * k + lane] * state[lanes * (nq + k) + lane];
      }
    }
    out[out.size - lanes + lane] = power;
  }
}

void add_work(
  const Manifold & manifold, Values tau, Values since, Values state, Index lanes, Values work)
{
  if (manifold.empty()) {
    for (Index i = 0; i < tau.size; ++i) {
      work[i % lanes] += tau[i] * (state[i] - since[i]);
    }
    return;
  }
  for (Index lane = 0; lane < lanes; ++lane) {
    double total = state[state.size - lanes + lane] - since[since.size - lanes + lane];
    for (Index i = 0; i < manifold.place.size; ++i) {
      if (manifold.place[i] >= 0) {
        const Index place = lanes * manifold.place[i] + lane;
        total += tau[lanes * i + lane] * (state[place] - since[place]);
      }
    }
    work[lane] += total;
  }
}

void move_lane(
  const Manifold & manifold, Values q, Values change, double share, Index lanes, Index lane)
{
  for (Index i = 0; i < manifold.place.size; ++i) {
    if (manifold.place[i] >= 0) {
      q[lanes * manifold.place[i] + lane] += share * change[lanes * i + lane];
    }
  }
  for (Index ball = 0; ball < manifold.balls.rows; ++ball) {
    const Index a = lanes * manifold.balls(ball, QUATERNION) + lane;
    const Index b = lanes * manifold.balls(ball, TURN) + lane;
    const double half = HALF * share;
    double i = half * change[b], j = half * change[b + lanes], k = half * change[b + 2 * lanes];
    const double angle = std::sqrt(i * i + j * j + k * k);
    // Beyond the last digit the sine is the angle.
    const double sine = angle > 1e-9 ? std::sin(angle) / angle : 1.0, s = std::cos(angle);
    i = sine * i;
    j = sine * j;
    k = sine * k;
    const double x = q[a], y = q[a + lanes], z = q[a + 2 * lanes], w = q[a + 3 * lanes];
    q[a] = w * i + x * s + y * k - z * j;
    q[a + lanes] = w * j + y * s + z * i - x * k;
    q[a + 2 * lanes] = w * k + z * s + x * j - y * i;
    q[a + 3 * lanes] = w * s - x * i - y * j - z * k;
  }
  normalise_lane(manifold, q, lanes, lane);
}

void move(const Manifold & manifold, Values q, Values change, double share, Index lanes)
{
  if (manifold.empty()) {
    for (Index i = 0; i < q.size; ++i) {
      q[i] += share * change[i];
    }
    return;
  }
  for (Index lane = 0; lane < lanes; ++lane) {
    move_lane(manifold, q, change, share, lanes, lane);
  }
}

void normalise(const Manifold & manifold, Values q, Index lanes)
{
  for (Index lane = 0; lane < lanes && !manifold.empty(); ++lane) {
    normalise_lane(manifold, q, lanes, lane);
  }
}

double error_weight(const Manifold & manifold, Index coordinate)
{
  for (Index ball = 0; ball < manifold.balls.rows; ++ball) {
    const Index behind = coordinate - manifold.balls(ball, QUATERNION);
    if (behind >= 0 && behind < 4) {
      return 1.0 / HALF;
    }
  }
  return 1.0;
}

void fill_numbers(const Manifold & manifold, Values q)
{
  for (Index i = 0; i < manifold.place.size; ++i) {
    manifold.number[i] = manifold.place[i] >= 0 ? q[manifold.place[i]] : 0.0;
  }
}

void fill_quaternions(Cube<double> matrices, Table out)
{
  for (Index n = 0; n < matrices.pages; ++n) {
    const Matrix<double> one = matrices[n];
    // A multiple of q: the row of q q^T with the largest diagonal entry shows it best.
    const double xx = one(0, 0), yy = one(1, 1), zz = one(2, 2);
    double x = one(2, 1) - one(1, 2), y = one(0, 2) - one(2, 0), z = one(1, 0) - one(0, 1);
    double w = 1.0 + xx + yy + zz;
    if (w < 1.0) {
      const double xy = one(0, 1) + one(1, 0), xz = one(0, 2) + one(2, 0);
      const double yz = one(1, 2) + one(2, 1);
      if (xx >= yy && xx >= zz) {
        w = x;
        x = 1.0 + xx - yy - zz;
        y = xy;
        z = xz;
      } else if (yy >= zz) {
        w = y;
        x = xy;
        y = 1.0 - xx + yy - zz;
        z = yz;
      } else {
        w = z;
        x = xz;
        y = yz;
        z = 1.0 - xx - yy + zz;
      }
    }
    const double size = std::copysign(std::sqrt(x * x + y * y + z * z + w * w), w);
    out(n, 0) = x / size;
    out(n, 1) = y / size;
    out(n, 2) = z / size;
    out(n, 3) = w / size;
  }
}

}  // namespace closedloop
