// A mechanism in Pinocchio, joint by joint. Called from peer_pinocchio.py.

#include "pinocchio_motion.hpp"

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
  Machine * machine = new Machine;
  Model & model = machine->model;
  for (int k = 0; k < joints; ++k) {
    const Model::JointIndex id = model.addJoint(
      parent[k], joint_of(kind[k]), placement(place + 7 * k), "joint_" + std::to_string(k));
    const double * b = body + 7 * k;
    model.appendBodyToJoint(
      id, pinocchio::Inertia(
        b[0], Vector3(b[1], b[2], b[3]),
        Eigen::Matrix3d(Vector3(b[4], b[5], b[6]).asDiagonal())));
  }
  model.gravity.linear() << gravity[0], gravity[1], gravity[2];
  for (int k = 0; k < pairs; ++k) {
    const double * p = points + 6 * k;
    machine->constraints.emplace_back(
      pinocchio::CONTACT_3D, model,
      ends[2 * k], pinocchio::SE3(Eigen::Matrix3d::Identity(), Vector3(p[0], p[1], p[2])),
      ends[2 * k + 1], pinocchio::SE3(Eigen::Matrix3d::Identity(), Vector3(p[3], p[4], p[5])),
      pinocchio::LOCAL);
  }
  machine->finish(mu, accuracy, iterations, by_bodies);
  return machine;
}

}  // extern "C"
