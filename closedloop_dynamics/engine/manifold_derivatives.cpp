// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "manifold_derivatives.hpp"

#include <cmath>

#include "null_space.hpp"

namespace closedloop
{

namespace
{
enum : Index {QUATERNION, TURN};
constexpr int FOUR = 4, THREE = 3;
// Below this angle the difference of sine and cosine is a series.
constexpr double SMALL = 0.03;

/// Derivatives of the components of one quaternion by those of another one, and by a rotation.
struct OfBall
{
  double by[FOUR][FOUR + THREE] = {};
};

/// The product of a quaternion and one with the vector and scalar `e`, by both.
void fill_product(
  const double * a, const double * e, double (& by_first)[FOUR][FOUR],
  double (& by_second)[FOUR][FOUR])
{
  const double first[FOUR][FOUR] = {
    {e[3], e[2], -e[1], e[0]}, {-e[2], e[3], e[0], e[1]}, {e[1], -e[0], e[3], e[2]},
    {-e[0], -e[1], -e[2], e[3]}};
  const double second[FOUR][FOUR] = {
    {a[3], -a[2], a[1], a[0]}, {a[2], a[3], -a[0], a[1]}, {-a[1], a[0], a[3], a[2]},
    {-a[0], -a[1], -a[2], a[3]}};
  for (int m = 0; m < FOUR; ++m) {
    for (int n = 0; n < FOUR; ++n) {
      by_first[m][n] = first[m][n];
      by_second[m][n] = second[m][n];
    }
  }
}

OfBall of_rates(const double * q, const double * rate)
{
  const double half[FOUR] = {0.5 * rate[0], 0.5 * rate[1], 0.5 * rate[2], 0.0};
  double by_first[FOUR][FOUR], by_second[FOUR][FOUR];
  fill_product(q, half, by_first, by_second);
  OfBall found;
  for (int m = 0; m < FOUR; ++m) {
    for (int n = 0; n < FOUR; ++n) {
      found.by[m][n] = by_first[m][n];
    }
    for (int n = 0; n < THREE; ++n) {
      found.by[m][FOUR + n] = 0.5 * by_second[m][n];
    }
  }
  return found;
}

/// Multiply by the derivative of p / |p|, (1 - n n^T) / |p|.
void normalise_columns(const double * p, OfBall & found)
{
  double square = 0.0;
  for (int m = 0; m < FOUR; ++m) {
    square += p[m] * p[m];
  }
  const double scale = 1.0 / std::sqrt(square);
  for (int n = 0; n < FOUR + THREE; ++n) {
    double along = 0.0;
    for (int m = 0; m < FOUR; ++m) {
      along += p[m] * found.by[m][n];
    }
    for (int m = 0; m < FOUR; ++m) {
      found.by[m][n] = scale * (found.by[m][n] - along / square * p[m]);
    }
  }
}

OfBall of_move(const double * q, const double * turn, double share)
{
  const double half = 0.5 * share;
  const double u[THREE] = {half * turn[0], half * turn[1], half * turn[2]};
  const double square = u[0] * u[0] + u[1] * u[1] + u[2] * u[2], angle = std::sqrt(square);
  const double cosine = std::cos(angle);
  const double sine = angle > 1e-9 ? std::sin(angle) / angle : 1.0;
  const double sinc_slope = angle > SMALL ? (cosine - sine) / square :
    -1.0 / 3.0 + square * (1.0 / 30.0 - square / 840.0);
  const double e[FOUR] = {sine * u[0], sine * u[1], sine * u[2], cosine};
  double by_first[FOUR][FOUR], by_second[FOUR][FOUR];
  fill_product(q, e, by_first, by_second);
  OfBall found;
  double product[FOUR] = {};
  for (int m = 0; m < FOUR; ++m) {
    for (int n = 0; n < FOUR; ++n) {
      found.by[m][n] = by_first[m][n];
      product[m] += by_second[m][n] * e[n];
    }
    for (int n = 0; n < THREE; ++n) {
      double total = by_second[m][n] * sine - by_second[m][3] * sine * u[n];
      for (int k = 0; k < THREE; ++k) {
        total += by_second[m][k] * sinc_slope * u[k] * u[n];
      }
      found.by[m][FOUR + n] = half * total;
    }
  }
  normalise_columns(product, found);
  return found;
}

OfBall of_norm(const double * q)
{
  OfBall found;
  for (int m = 0; m < FOUR; ++m) {
    found.by[m][m] = 1.0;
  }
  normalise_columns(q, found);
  return found;
}

/// Change coordinates: numbers by `kept` times their own change and `share` times that of their
/// displacement, quaternions by their derivatives. `out` may be `change`.
template<class Ball>
void push(
  const Manifold & manifold, double kept, double share, Values change, Values displacement,
  Values out, Ball && ball_at)
{
  for (Index i = 0; i < manifold.place.size; ++i) {
    const Index place = manifold.place[i];
    if (place >= 0) {
      out[place] = kept * change[place] + share * displacement[i];
    }
  }
  for (Index ball = 0; ball < manifold.balls.rows; ++ball) {
    const Index a = manifold.balls(ball, QUATERNION), b = manifold.balls(ball, TURN);
    const OfBall found = ball_at(a, b);
    double total[FOUR] = {};
    for (int m = 0; m < FOUR; ++m) {
      for (int n = 0; n < FOUR; ++n) {
        total[m] += found.by[m][n] * change[a + n];
      }
      for (int n = 0; n < THREE; ++n) {
        total[m] += found.by[m][FOUR + n] * displacement[b + n];
      }
    }
    for (int m = 0; m < FOUR; ++m) {
      out[a + m] = total[m];
    }
  }
}

/// The transpose: with `moved`, `of_q` are the weights, in which weights of numbers stay; else rates do
/// not follow numbers.
template<class Ball>
void pull(
  const Manifold & manifold, double share, bool moved, Values weight, Values of_q,
  Values of_displacement, Index lanes, Ball && ball_at)
{
  for (Index i = 0; i < manifold.place.size; ++i) {
    const Index place = manifold.place[i] * lanes;
    if (place >= 0) {
      dense(of_displacement.part(i * lanes, lanes)) += share * dense(weight.part(place, lanes));
    }
  }
  for (Index ball = 0; ball < manifold.balls.rows; ++ball) {
    const Index a = manifold.balls(ball, QUATERNION), b = manifold.balls(ball, TURN);
    const OfBall found = ball_at(a, b);
    for (Index lane = 0; lane < lanes; ++lane) {
      double total[FOUR + THREE] = {};
      for (int n = 0; n < FOUR + THREE; ++n) {
        for (int m = 0; m < FOUR; ++m) {
          total[n] += found.by[m][n] * weight[(a + m) * lanes + lane];
        }
      }
      for (int n = 0; n < FOUR; ++n) {
        double & to = of_q[(a + n) * lanes + lane];
        to = (moved ? 0.0 : to) + total[n];
      }
      for (int n = 0; n < THREE; ++n) {
        of_displacement[(b + n) * lanes + lane] += total[FOUR + n];
      }
    }
  }
}
}  // namespace

void change_of_rates(
  const Manifold & manifold, Values q, Values qd, Values change, Values change_of_rate, Values out)
{
  if (manifold.empty()) {
    copy(change_of_rate, out);
    return;
  }
  push(
    manifold, 0.0, 1.0, change, change_of_rate, out, [&](Index a, Index b) {
      return of_rates(&q[a], &qd[b]);
    });
}

void weights_of_rates(
  const Manifold & manifold, Values q, Values qd, Values weight, Values of_q, Values of_qd,
  Index lanes)
{
  if (manifold.empty()) {
    dense(of_qd) += dense(weight);
    return;
  }
  pull(
    manifold, 1.0, false, weight, of_q, of_qd, lanes, [&](Index a, Index b) {
      return of_rates(&q[a], &qd[b]);
    });
}

void change_of_move(
  const Manifold & manifold, Values q, Values displacement, double share, Values change,
  Values change_of_displacement)
{
  if (manifold.empty()) {
    for (Index i = 0; i < change.size; ++i) {
      change[i] += share * change_of_displacement[i];
    }
    return;
  }
  push(
    manifold, 1.0, share, change, change_of_displacement, change, [&](Index a, Index b) {
      return of_move(&q[a], &displacement[b], share);
    });
}

void weights_of_move(
  const Manifold & manifold, Values q, Values displacement, double share, Values weight,
  Values of_displacement, Index lanes)
{
  if (manifold.empty()) {
    dense(of_displacement) += share * dense(weight);
    return;
  }
  pull(
    manifold, share, true, weight, weight, of_displacement, lanes, [&](Index a, Index b) {
      return of_move(&q[a], &displacement[b], share);
    });
}

void change_of_norm(const Manifold & manifold, Values q, Values change, Index lanes)
{
  for (Index ball = 0; ball < manifold.balls.rows; ++ball) {
    const Index a = manifold.balls(ball, QUATERNION);
    const OfBall found = of_norm(&q[a]);
    for (Index lane = 0; lane < lanes; ++lane) {
      double total[FOUR] = {};
      for (int m = 0; m < FOUR; ++m) {
        for (int n = 0; n < FOUR; ++n) {
          total[m] += found.by[m][n] * change[(a + n) * lanes + lane];
        }
      }
      for (int m = 0; m < FOUR; ++m) {
        change[(a + m) * lanes + lane] = total[m];
      }
    }
  }
}

}  // namespace closedloop
