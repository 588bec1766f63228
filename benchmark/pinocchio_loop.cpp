// Pinocchio's constraintDynamics and lcaba in loops of C++, without Python between two
// evaluations: evaluations alone, the classical Runge-Kutta method, and the error-controlled
// Runge-Kutta-Fehlberg 7(8) of Boost.Numeric.Odeint. Called from peer_pinocchio.py.

#define PINOCCHIO_ENABLE_TEMPLATE_INSTANTIATION
#include <pinocchio/spatial.hpp>
#include <pinocchio/multibody.hpp>
#include <pinocchio/algorithm/constrained-dynamics.hpp>
#include <pinocchio/algorithm/loop-constrained-aba.hpp>

#include <boost/numeric/odeint/integrate/integrate_adaptive.hpp>
#include <boost/numeric/odeint/stepper/generation.hpp>
#include <boost/numeric/odeint/stepper/runge_kutta_fehlberg78.hpp>

#include <cmath>
#include <string>
#include <utility>
#include <vector>

namespace odeint = boost::numeric::odeint;
using State = std::vector<double>;

namespace
{

using Vector3 = Eigen::Vector3d;

// Three numbers of a place, four of a quaternion x, y, z, w.
pinocchio::SE3 placement(const double * p)
{
  const Eigen::Quaterniond turn(p[6], p[3], p[4], p[5]);
  return pinocchio::SE3(turn.normalized().toRotationMatrix(), Vector3(p[0], p[1], p[2]));
}

// Kinds: 0 to 2 revolute about x, y, z, 3 to 5 prismatic along them, 6 spherical, from 10 on
// universal, 3 * first axis + second axis more.
pinocchio::JointModel joint_of(int kind)
{
  switch (kind) {
    case 0: return pinocchio::JointModelRX();
    case 1: return pinocchio::JointModelRY();
    case 2: return pinocchio::JointModelRZ();
    case 3: return pinocchio::JointModelPX();
    case 4: return pinocchio::JointModelPY();
    case 5: return pinocchio::JointModelPZ();
    case 6: return pinocchio::JointModelSpherical();
    default:
      return pinocchio::JointModelUniversal(
        Vector3::Unit((kind - 10) / 3), Vector3::Unit((kind - 10) % 3));
  }
}

struct Loop
{
  pinocchio::Model model;
  pinocchio::Data data;
  PINOCCHIO_ALIGNED_STD_VECTOR(pinocchio::RigidConstraintModel) constraints;
  PINOCCHIO_ALIGNED_STD_VECTOR(pinocchio::RigidConstraintData) constraint_data;
  pinocchio::ProximalSettings settings;
  bool by_bodies;
  Eigen::VectorXd q, v, tau, rates;
  // First coordinate and first rate of each quaternion.
  std::vector<std::pair<int, int>> balls;

  const Eigen::VectorXd & accelerate()
  {
    if (by_bodies) {
      return pinocchio::lcaba(model, data, q, v, tau, constraints, constraint_data, settings);
    }
    return pinocchio::constraintDynamics(
      model, data, q, v, tau, constraints, constraint_data, settings);
  }

  void normalise()
  {
    for (const auto & ball : balls) {
      q.segment<4>(ball.first).normalize();
    }
  }

  // Derivatives of the coordinates, a part of the rates where there are no quaternions.
  const Eigen::VectorXd & coordinate_rates()
  {
    if (balls.empty()) {
      return v;
    }
    for (pinocchio::JointIndex k = 1; k < pinocchio::JointIndex(model.njoints); ++k) {
      const int iq = model.idx_qs[k], iv = model.idx_vs[k];
      if (model.nqs[k] == model.nvs[k]) {
        rates.segment(iq, model.nqs[k]) = v.segment(iv, model.nvs[k]);
        continue;
      }
      const double x = q[iq], y = q[iq + 1], z = q[iq + 2], w = q[iq + 3];
      const double a = 0.5 * v[iv], b = 0.5 * v[iv + 1], c = 0.5 * v[iv + 2];
      rates[iq] = w * a + y * c - z * b;
      rates[iq + 1] = w * b + z * a - x * c;
      rates[iq + 2] = w * c + x * b - y * a;
      rates[iq + 3] = -(x * a + y * b + z * c);
    }
    return rates;
  }

  void operator()(const State & state, State & rate, double)
  {
    const int nq = model.nq, nv = model.nv;
    q = Eigen::Map<const Eigen::VectorXd>(state.data(), nq);
    v = Eigen::Map<const Eigen::VectorXd>(state.data() + nq, nv);
    normalise();
    Eigen::Map<Eigen::VectorXd>(rate.data(), nq) = coordinate_rates();
    Eigen::Map<Eigen::VectorXd>(rate.data() + nq, nv) = accelerate();
  }
};

}  // namespace

extern "C" {

// Per joint: parent (0 is the ground, joints count from 1), kind, place and orientation in the
// parent's frame, mass, centre of mass, principal inertia about it. Per pair of points that is
// held together: two joints, two points.
void * create(
  int joints, const int * parent, const int * kind, const double * place, const double * body,
  int pairs, const int * ends, const double * points, const double * gravity, double mu,
  double accuracy, int iterations, int by_bodies)
{
  using pinocchio::Model;
  Loop * loop = new Loop;
  Model & model = loop->model;
  for (int k = 0; k < joints; ++k) {
    const Model::JointIndex id = model.addJoint(
      parent[k], joint_of(kind[k]), placement(place + 7 * k), "joint_" + std::to_string(k));
    const double * b = body + 7 * k;
    model.appendBodyToJoint(
      id, pinocchio::Inertia(
        b[0], Vector3(b[1], b[2], b[3]),
        Eigen::Matrix3d(Vector3(b[4], b[5], b[6]).asDiagonal())));
    if (model.nqs[id] != model.nvs[id]) {
      loop->balls.emplace_back(model.idx_qs[id], model.idx_vs[id]);
    }
  }
  model.gravity.linear() << gravity[0], gravity[1], gravity[2];
  for (int k = 0; k < pairs; ++k) {
    const double * p = points + 6 * k;
    loop->constraints.emplace_back(
      pinocchio::CONTACT_3D, model,
      ends[2 * k], pinocchio::SE3(Eigen::Matrix3d::Identity(), Vector3(p[0], p[1], p[2])),
      ends[2 * k + 1], pinocchio::SE3(Eigen::Matrix3d::Identity(), Vector3(p[3], p[4], p[5])),
      pinocchio::LOCAL);
  }
  for (const auto & constraint : loop->constraints) {
    loop->constraint_data.emplace_back(constraint);
  }
  loop->data = pinocchio::Data(model);
  loop->settings = pinocchio::ProximalSettings(accuracy, mu, iterations);
  loop->by_bodies = by_bodies != 0;
  if (loop->by_bodies) {
    pinocchio::computeJointMinimalOrdering(model, loop->data, loop->constraints);
  } else {
    pinocchio::initConstraintDynamics(model, loop->data, loop->constraints, loop->constraint_data);
  }
  loop->q = loop->rates = Eigen::VectorXd::Zero(model.nq);
  loop->v = loop->tau = Eigen::VectorXd::Zero(model.nv);
  return loop;
}

void set_state(void * handle, const double * q, const double * v, const double * tau)
{
  Loop & loop = *static_cast<Loop *>(handle);
  loop.q = Eigen::Map<const Eigen::VectorXd>(q, loop.model.nq);
  loop.v = Eigen::Map<const Eigen::VectorXd>(v, loop.model.nv);
  loop.tau = Eigen::Map<const Eigen::VectorXd>(tau, loop.model.nv);
}

void get_position(void * handle, double * q)
{
  Loop & loop = *static_cast<Loop *>(handle);
  Eigen::Map<Eigen::VectorXd>(q, loop.model.nq) = loop.q;
}

void evaluate(void * handle, long count, double * acceleration)
{
  Loop & loop = *static_cast<Loop *>(handle);
  for (long k = 0; k < count; ++k) {
    loop.accelerate();
  }
  Eigen::Map<Eigen::VectorXd>(acceleration, loop.model.nv) = loop.data.ddq;
}

void runge_kutta_4(void * handle, double step, long steps)
{
  Loop & loop = *static_cast<Loop *>(handle);
  const int nq = loop.model.nq, nv = loop.model.nv;
  Eigen::VectorXd q0(nq), v0(nv), q_sum(nq), a_sum(nv), slope(nq);
  for (long k = 0; k < steps; ++k) {
    q0 = loop.q;
    v0 = loop.v;
    q_sum.setZero();
    a_sum.setZero();
    for (int stage = 0; stage < 4; ++stage) {
      const double weight = (stage == 0 || stage == 3) ? 1.0 : 2.0;
      const Eigen::VectorXd & a = loop.accelerate();
      slope = loop.coordinate_rates();
      q_sum += weight * slope;
      a_sum += weight * a;
      if (stage < 3) {
        const double part = stage == 2 ? step : 0.5 * step;
        loop.q = q0 + part * slope;
        loop.v = v0 + part * a;
        loop.normalise();
      }
    }
    loop.q = q0 + step / 6.0 * q_sum;
    loop.v = v0 + step / 6.0 * a_sum;
    loop.normalise();
  }
}

void fehlberg_78(void * handle, double duration, double tolerance, double first_step)
{
  Loop & loop = *static_cast<Loop *>(handle);
  const int nq = loop.model.nq, nv = loop.model.nv;
  State state(nq + nv);
  Eigen::Map<Eigen::VectorXd>(state.data(), nq) = loop.q;
  Eigen::Map<Eigen::VectorXd>(state.data() + nq, nv) = loop.v;
  odeint::integrate_adaptive(
    odeint::make_controlled(
      tolerance, tolerance, odeint::runge_kutta_fehlberg78<State>()),
    std::ref(loop), state, 0.0, duration, first_step);
  loop.q = Eigen::Map<Eigen::VectorXd>(state.data(), nq);
  loop.v = Eigen::Map<Eigen::VectorXd>(state.data() + nq, nv);
  loop.normalise();
}

void destroy(void * handle) { delete static_cast<Loop *>(handle); }

}  // extern "C"
