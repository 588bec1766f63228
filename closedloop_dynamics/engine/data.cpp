// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "data.hpp"

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "batch.hpp"
#include "bounds.hpp"
#include "left_out.hpp"
#include "library.hpp"

namespace closedloop
{

// Generated code finds the size so many places behind the gain (codegen/routines.py).
static_assert(
  offsetof(Settings, size) - offsetof(Settings, baumgarte_gain) == 4 * sizeof(double));

namespace
{
// Many more than the operations of the largest routine.
constexpr Index MOST_FACTORS = 1'000'000;

void require(bool good, const char * what)
{
  if (!good) {
    throw std::invalid_argument(what);
  }
}

/// Copy words of eight bytes; there may be none, and then no place for them.
void copy_words(double * to, const double * from, Index count)
{
  if (count > 0) {
    std::memcpy(to, from, static_cast<std::size_t>(count) * sizeof(double));
  }
}

/// Collects where the numbers of arrays are: all have eight bytes.
class Numbers
{
public:
  template<class ... Field>
  void operator()(const char *, Field & ... field) {(add(field), ...);}

  std::vector<Values> found;

private:
  void add(const std::shared_ptr<Settings> &) {}
  template<class View>
  auto add(View & view)->decltype(view.all(), void())
  {
    found.push_back({reinterpret_cast<double *>(view.all().data), view.all().size});
  }
  template<class Record>
  auto add(Record & record)->decltype(record.arrays(*this)) {record.arrays(*this);}
};
}  // namespace

AllEquations::AllEquations(const Model & all, const Model & some, const Workspace & shared)
: model(all), work(all), lam(all.equations()), kept(all.equations()), own(all), numbers(left_out::COLUMNS),
  energy(2)
{
  work.body = shared.body;
  work.health = shared.health;
  for (Index a = 0; a < some.cut.rows; ++a) {
    // One bit for each equation that the type of the joint has.
    Index row = all.cut(a, cut::CUT_ROW);
    for (Index n = 0; n < 6; ++n) {
      if ((all.cut(a, cut::POSSIBLE) >> n & 1) != 0) {
        kept[row++] = some.cut(a, cut::KEPT) >> n & 1;
      }
    }
  }
}

JointPlaces::JointPlaces(const Model & model, Indices row, Indexes body, Table point)
: row(Array<Indices>::copy_of(row)), body(Array<Indexes>::copy_of(body)),
  point(Array<Table>::copy_of(point))
{
  const Index nv = model.joints();
  require(
    point.rows == 2 * body.rows && row.size <= body.rows &&
    (body.rows == 0 || (body.columns == 2 && point.columns == (model.planar() ? 2 : 3))) &&
    within(row, 1, nv) && (body.rows == 0 || (within(body, 0, 0, 0, nv) &&
    within(body, 1, 0, 0, nv))),
    "places of joints: expected bodies of the model, and two points each");
}

Data::Data(
  const Model & model, const Model & all, const Settings & settings, const JointPlaces & joints,
  const EffectTable & effects, Indices code)
: model(model), work(model), settings(std::make_shared<Settings>(settings)),
  tau(model.joints() + effects.cuts.index.rows), qdd(model.joints()), lam(model.equations()),
  effects(effects), manifold(model), joints(joints), passage(1 + model.coordinates())
{
  require(model.is_connected(), "model: expected addresses of code for its joints");
  if (all.cut.data != model.cut.data) {
    whole = AllEquations(all, model, work);
  }
  link(code);
}

Data::Data(const Data & like, const Model & model, const Model & all, Indices code)
: Data(like)
{
  require(
    model.tree.data == like.model.tree.data && all.tree.data == model.tree.data,
    "expected models of the mechanism of the system");
  const Values before = like.work.health;
  this->model = model;
  work = Workspace(model);
  closedloop::copy(before, work.health);
  use_independent(is_independent());
  lam = Array<Values>(model.equations());
  whole = all.cut.data != model.cut.data ? AllEquations(all, model, work) : AllEquations();
  derivatives = {};
  owner_of_derivatives = nullptr;
  link(code);
}

bool LatestEvaluation::is_of(Values state, Values tau) const
{
  // By their bits.
  const auto same = [](const std::vector<double> & kept, Values now) {
      return static_cast<Index>(kept.size()) == now.size &&
             std::memcmp(kept.data(), now.data, sizeof(double) * kept.size()) == 0;
    };
  return known_ && same(state_, state) && same(tau_, tau);
}

void LatestEvaluation::keep(Values state, Values tau)
{
  state_.assign(state.begin(), state.end());
  tau_.assign(tau.begin(), tau.end());
  known_ = true;
}

void Data::use_equations(const Model & other, const Model & all, Indices code)
{
  *this = Data(*this, other, all, code);
}

Data Data::copy() const
{
  Data made(*this);
  Copies separate;
  made.arrays(separate);
  made.derivatives = {};
  made.owner_of_derivatives = nullptr;
  made.worker = std::make_shared<std::thread::id>();
  made.latest = std::make_shared<LatestEvaluation>();
  made.connect();
  return made;
}

void Data::take(const Data & from)
{
  Numbers own, others;
  // Addresses of arrays stay as they are.
  const std::vector<Index> addresses(
    table.begin() + routine::BODY, table.begin() + routine::TABLE_COLUMNS);
  Data other(from);
  arrays(own);
  other.arrays(others);
  require(
    std::equal(
      own.found.begin(), own.found.end(), others.found.begin(), others.found.end(),
      [](Values one, Values another) {return one.size == another.size;}),
    "expected a copy of the same data");
  for (std::size_t n = 0; n < own.found.size(); ++n) {
    copy_words(own.found[n].data, others.found[n].data, own.found[n].size);
  }
  std::copy(addresses.begin(), addresses.end(), table.begin() + routine::BODY);
  *settings = *from.settings;
}

Snapshot::Snapshot(const Data & data)
: data_(data)
{
  Numbers numbers;
  data_.arrays(numbers);
  places_ = std::move(numbers.found);
  std::size_t size = 0;
  for (Values place : places_) {
    size += static_cast<std::size_t>(place.size);
  }
  kept_.resize(size);
  double * next = kept_.data();
  for (Values place : places_) {
    copy_words(next, place.data, place.size);
    next += place.size;
  }
}

void Snapshot::restore() const
{
  const double * next = kept_.data();
  for (Values place : places_) {
    copy_words(place.data, next, place.size);
    next += place.size;
  }
}

void Data::use_derivatives(const AccelerationDerivatives & given, std::shared_ptr<void> owner)
{
  const Index columns = LANES * (nv() + lam.size);
  require(
    given.table.size >= 2 && given.table[1] != 0 && given.columns.rows * LANES >= 2 * nv() &&
    has_shape(given.columns, given.columns.rows, columns) &&
    has_shape(given.found, given.columns.rows, columns) &&
    has_shape(given.flows, 2 * nv(), effects.states.size),
    "derivatives: expected arrays for this system");
  derivatives = given;
  owner_of_derivatives = std::move(owner);
}

void Data::forget()
{
  if (is_independent()) {
    partition.forget();
  }
  whole.numbers.fill(0.0);
}

void Data::link(Indices code)
{
  require(
    code.size == 0 || code.size == routine::TABLE_COLUMNS,
    "expected addresses of routines by place in the function table");
  // Code of a scene alone has addresses of functions of the engine.
  require(
    has_effects() || code.size == 0 || code[routine::PIECE] == 0,
    "effects: expected those that the code was generated for, got none");
  table = Array<Indices>(routine::TABLE_COLUMNS);
  closedloop::copy(code, table.part(0, code.size));
  corrections = Array<Table>(2, code.size == 0 ? 0 : nv());
  require(
    table[routine::FACTORS] >= 0 && table[routine::FACTORS] <= MOST_FACTORS,
    "expected how many factors are kept");
  factors = Array<Values>(table[routine::FACTORS]);
  const bool feels = has_effects() && effects.loaded[0] != 0;
  const bool is_whole = has_effects() ? effects.code.fits[0] != 0 : code.size > 0;
  require(
    code.size == 0 || (std::all_of(
      table.data + routine::OUTWARD, table.data + routine::CORRECTION + 1,
      [](Index address) {return address != 0;}) &&
    (!is_whole || table[routine::EVALUATION] != 0 || table[routine::MOTION] != 0) &&
    (!feels || !whole.empty() || table[routine::REACTIONS] != 0)),
    "expected the addresses of all routines");
  connect();
}

void Data::connect()
{
  require(
    !has_effects() || effects.fits(model, whole.empty() ? model : whole.model),
    "effects: expected a table for this mechanism");
  applied = has_effects() ? effects.applied.part(0, nv()) : tau.part(0, nv());
  const struct {Index place; const double * array;} arrays[] = {
    {routine::BODY, model.body.data}, {routine::GRAVITY, model.gravity.data},
    {routine::CUT_POINT, model.cut_point.data}, {routine::TAU, applied.data},
    {routine::BAUMGARTE, &settings->baumgarte_gain}, {routine::QDD, qdd.data},
    {routine::LAM, lam.data}, {routine::HEALTH, work.health.data},
    {routine::WORK_BODY, work.body.data}, {routine::CLOSURE, work.closure.data},
    {routine::CLOSURE_RATE, work.closure_rate.data}, {routine::CORRECTIONS, corrections.data},
    {routine::WRENCH, work.force.data}, {routine::JOINT_POINT, joints.point.data},
    {routine::LAM_OF_ALL, whole.lam.data}, {routine::REACTION, effects.reaction.data},
    {routine::COMMAND, tau.data}, {routine::VALUES, effects.values.data},
    {routine::ENTRIES, effects.data.data}, {routine::CUT_VALUES, effects.cuts.values.data},
    {routine::PRESENT, effects.code.present.data}, {routine::SIDES, effects.code.sides.data},
    {routine::GAPS, effects.contacts.now.data}, {routine::TRIALS, effects.contacts.trial.data},
    {routine::RATES, effects.rates.data}, {routine::RESPONSE, effects.static_friction.response.data},
    {routine::LIMIT, effects.static_friction.right.data},
    {routine::FACTORS, factors.data}};
  for (const auto & each : arrays) {
    table[each.place] = reinterpret_cast<Index>(each.array);
  }
}

}  // namespace closedloop
