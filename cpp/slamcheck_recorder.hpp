// Records what a Kalman filter does, for `slamcheck audit`. C++17, this header and sqlite3 alone:
//
//   c++ -std=c++17 filter.cpp -lsqlite3
//
// On a machine without sqlite3, define SLAMCHECK_NO_SQLITE and record to a file whose name ends in
// .events, which slamcheck reads as well.
//
//   slamcheck::Recorder record("run.trace");
//   record.prior({{"position", 2}, {"velocity", 2}}, P);
//   record.predict(F, Q);
//   record.update("gps", residual, H, R, {"position"});
//   record.snapshot(P);
//
// The error state is truth minus estimate, in the coordinates of the filter's covariance, and
// consists of named blocks. Call a method where the filter does what its name says, with the
// matrices that the filter uses. Blocks that are left out are all blocks, in their order. Every
// fault is a std::runtime_error of one line; what was committed before stays a sound trace.
// Calls of one recorder must not overlap. docs/audit-format.md describes the file.
#pragma once

#ifndef SLAMCHECK_NO_SQLITE
#include <sqlite3.h>
#endif

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <initializer_list>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <unordered_map>
#include <unordered_set>
#include <utility>
#include <vector>

#if defined(__unix__) || defined(__APPLE__)
#include <unistd.h>
#endif

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "slamcheck_recorder.hpp stores numbers as they lie in memory: little-endian alone"
#endif

namespace slamcheck {

static_assert(sizeof(double) == 8 && std::numeric_limits<double>::is_iec559, "float64 is needed");

namespace detail {

template <class M, class = void>
struct HasEntries : std::false_type {};
template <class M>
struct HasEntries<M, std::void_t<decltype(std::declval<const M&>().rows()),
                                 decltype(std::declval<const M&>().cols()),
                                 decltype(static_cast<double>(std::declval<const M&>()(0, 0)))>>
    : std::true_type {};

}  // namespace detail

// Numbers row by row. Any type with rows(), cols() and (i, j) converts to it, Eigen's matrices
// too: entries are asked for one by one, so their storage order does not matter. An expression
// such as H * F is evaluated first: (H * F).eval().
class Matrix {
 public:
  Matrix() = default;

  // values: rows * cols of them, row by row (not the data() of Eigen's column-major matrices).
  Matrix(const double* values, std::size_t rows, std::size_t cols)
      : rows_(rows), cols_(cols), values_(values, values + rows * cols) {}

  Matrix(std::initializer_list<std::initializer_list<double>> rows)
      : rows_(rows.size()), cols_(rows.size() ? rows.begin()->size() : 0) {
    for (const auto& row : rows) {
      if (row.size() != cols_) throw std::runtime_error("a matrix has rows of different lengths");
      values_.insert(values_.end(), row.begin(), row.end());
    }
  }

  template <class M, class = std::enable_if_t<detail::HasEntries<M>::value>>
  Matrix(const M& matrix)
      : rows_(static_cast<std::size_t>(matrix.rows())),
        cols_(static_cast<std::size_t>(matrix.cols())) {
    values_.reserve(rows_ * cols_);
    for (decltype(matrix.rows()) i = 0; i < matrix.rows(); ++i) {
      for (decltype(matrix.cols()) j = 0; j < matrix.cols(); ++j) {
        values_.push_back(static_cast<double>(matrix(i, j)));
      }
    }
  }

  std::size_t row_count() const { return rows_; }
  std::size_t column_count() const { return cols_; }
  const std::vector<double>& values() const { return values_; }

 private:
  std::size_t rows_ = 0, cols_ = 0;
  std::vector<double> values_;
};

// Numbers. Eigen's vectors and anything with data() and size() convert to it.
class Vector {
 public:
  Vector() = default;
  Vector(const double* values, std::size_t size) : values_(values, values + size) {}
  Vector(std::initializer_list<double> values) : values_(values) {}

  template <class V, class = std::enable_if_t<!std::is_same_v<V, Vector>>,
            class = decltype(std::declval<const V&>().size())>
  Vector(const V& vector) {
    if constexpr (detail::HasEntries<V>::value) {
      if (vector.rows() != 1 && vector.cols() != 1) {
        throw std::runtime_error("a matrix stands where a vector is expected");
      }
      values_ = Matrix(vector).values();
    } else {
      values_.assign(vector.data(), vector.data() + vector.size());
    }
  }

  const std::vector<double>& values() const { return values_; }

 private:
  std::vector<double> values_;
};

// What is known of a sensor. gate: the probability with which the filter's gate lets a sound
// measurement pass. components: names of the residual's entries.
struct Sensor {
  std::string name;
  std::optional<double> gate;
  std::vector<std::string> components;
};

// What slamcheck check needs of an event beside what the filter used. point: its blocks' own
// numbers, about which it was linearised; of a prediction those before it. after: what it leads to,
// of a prediction or a new block. numbers: of what was measured, in the log. weight: below 1 for a
// part of a measurement. chart: of a new block's error, see docs/audit-format.md.
struct About {
  Vector point, after, numbers;
  std::optional<double> weight;
  std::string chart = "additive";
};

namespace detail {

// Where batches go: a file, one after the other. What is written when it fails is left out.
class RawFile {
 public:
  RawFile(const std::string& path, const std::string& sensors, bool synced)
      : file_(std::fopen(path.c_str(), "ab")), synced_(synced) {
    std::string head = "slamcheck events";
    const std::int64_t numbers[2] = {2, static_cast<std::int64_t>(sensors.size())};
    head.append(reinterpret_cast<const char*>(numbers), sizeof numbers);
    put(head + sensors);
    sync();
  }
  RawFile(const RawFile&) = delete;
  RawFile& operator=(const RawFile&) = delete;
  ~RawFile() {
    if (file_) std::fclose(file_);
  }

  void add(const std::int64_t (&counts)[4], const std::string& state, const std::string& data) {
    std::string head(reinterpret_cast<const char*>(counts), sizeof counts);
    const std::int64_t sizes[2] = {static_cast<std::int64_t>(state.size()),
                                   static_cast<std::int64_t>(data.size())};
    head.append(reinterpret_cast<const char*>(sizes), sizeof sizes);
    put(head + state);
    put(data);
    sync();
  }

  // A child of a fork leaves its parent's file alone.
  void abandon() { file_ = nullptr; }

 private:
  void put(const std::string& bytes) {
    if (!file_ || std::fwrite(bytes.data(), 1, bytes.size(), file_) != bytes.size() ||
        std::fflush(file_) != 0) {
      throw std::runtime_error(std::strerror(errno));
    }
  }

  void sync() {
#if defined(__unix__) || defined(__APPLE__)
    if (synced_ && fsync(fileno(file_)) != 0) throw std::runtime_error(std::strerror(errno));
#endif
  }

  std::FILE* file_;
  bool synced_;
};

#ifndef SLAMCHECK_NO_SQLITE
// Where batches go: an SQLite file, each in a transaction.
class Database {
 public:
  Database(const std::string& path, bool synced) {
    const int flags = SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE;
    try {
      check(sqlite3_open_v2(path.c_str(), &file_, flags, nullptr));
      sqlite3_busy_timeout(file_, 5000);
      execute(synced ? "PRAGMA synchronous = EXTRA" : "PRAGMA synchronous = OFF");
      execute("PRAGMA page_size = 32768; PRAGMA cache_spill = OFF;"
              "PRAGMA application_id = 1397506388; PRAGMA user_version = 2; BEGIN;"
              "CREATE TABLE batch (first INTEGER PRIMARY KEY, events INTEGER NOT NULL, "
              "updates INTEGER NOT NULL, snapshots INTEGER NOT NULL, state TEXT NOT NULL, "
              "data BLOB NOT NULL);"
              "CREATE TABLE sensor (name TEXT PRIMARY KEY, gate REAL, components TEXT)");
    } catch (...) {
      sqlite3_close(file_);
      throw;
    }
  }
  Database(const Database&) = delete;
  Database& operator=(const Database&) = delete;
  ~Database() { sqlite3_close(file_); }

  void sensor(const std::string& name, const std::optional<double>& gate,
              const std::string& components) {
    insert("INSERT OR REPLACE INTO sensor VALUES (?, ?, ?)", [&](sqlite3_stmt* row) {
      text(row, 1, name);
      if (gate) check(sqlite3_bind_double(row, 2, *gate));
      if (!components.empty()) text(row, 3, components);
    });
  }

  void commit() { execute("COMMIT"); }

  void add(const std::int64_t (&counts)[4], const std::string& state, const std::string& data) {
    execute("BEGIN IMMEDIATE");
    insert("INSERT INTO batch VALUES (?, ?, ?, ?, ?, ?)", [&](sqlite3_stmt* row) {
      for (int i = 0; i < 4; ++i) check(sqlite3_bind_int64(row, i + 1, counts[i]));
      text(row, 5, state);
      check(sqlite3_bind_blob64(row, 6, data.data(), data.size(), SQLITE_STATIC));
    });
    execute("COMMIT");
  }

  void abandon() { file_ = nullptr; }

 private:
  template <class Bind>
  void insert(const char* sql, const Bind& bind) {
    sqlite3_stmt* row = nullptr;
    check(sqlite3_prepare_v2(file_, sql, -1, &row, nullptr));
    const std::unique_ptr<sqlite3_stmt, int (*)(sqlite3_stmt*)> kept(row, sqlite3_finalize);
    bind(row);
    const int code = sqlite3_step(row);
    if (code != SQLITE_DONE) check(code);
  }
  void text(sqlite3_stmt* row, int column, const std::string& value) {
    check(sqlite3_bind_text64(row, column, value.data(), value.size(), SQLITE_STATIC,
                              SQLITE_UTF8));
  }
  void execute(const char* sql) { check(sqlite3_exec(file_, sql, nullptr, nullptr, nullptr)); }
  void check(int code) {
    if (code == SQLITE_OK) return;
    throw std::runtime_error(file_ ? sqlite3_errmsg(file_) : sqlite3_errstr(code));
  }

  sqlite3* file_ = nullptr;
};
#endif

}  // namespace detail

class Recorder {
 public:
  using Names = std::vector<std::string>;

  // Starts a file, which must not exist: in SQLite, or without it where its name ends in .events.
  // synced: wait at each commit until it is on the disk, so that a power failure leaves what was
  // committed. Without it a kill still does, but a power failure may damage all.
  explicit Recorder(const std::string& path, const std::vector<Sensor>& sensors = {},
                    bool synced = true)
      : path_(path) {
    for (const Sensor& one : sensors) {
      check_name(one.name);
      for (const std::string& part : one.components) check_name(part);
      if (one.gate && !(*one.gate > 0.0 && *one.gate < 1.0)) {
        fail("gate of sensor " + quoted(one.name) + " is not a probability between 0 and 1");
      }
    }
    std::FILE* fresh = std::fopen(path.c_str(), "wbx");
    if (!fresh) fail("exists already, or cannot be written; give a new name");
    std::fclose(fresh);
    try {
      open(sensors, synced);
    } catch (...) {
      release();
      std::remove(path.c_str());
      throw;
    }
  }

  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;

  // Commits and closes. A fault has nobody to tell: call close() to hear of it.
  ~Recorder() {
    try {
      close();
    } catch (...) {
      release();
    }
  }

  // Commits what is recorded and closes the file.
  void close() {
    if (!is_open()) return;
    commit();
    release();
  }

  // Writes what is recorded so far; it is done by itself every 2,000 events or 16 MiB.
  void commit() {
    check_open();
    if (rows_.empty()) return;
    const std::int64_t counts[4] = {first_, number_ - first_, updates_, snapshots_};
    std::string state = "[";
    for (const std::string& name : order_) {
      const Block& one = dims_.at(name);
      state += (state.size() > 1 ? ", [" : "[") + quoted(name) + ", " + std::to_string(one.dim) +
               ", " + quoted(one.chart) + "]";
    }
    state += "]";
    const std::string data = pack();
    writing([&] {
#ifndef SLAMCHECK_NO_SQLITE
      if (database_) database_->add(counts, state, data);
#endif
      if (raw_) raw_->add(counts, padded(state, ' '), data);
    });
    first_ = number_;
    rows_.clear();
    texts_.clear();
    spoken_.clear();
    matrices_.clear();
    stored_.clear();
    updates_ = snapshots_ = 0;
    pending_bytes_ = 0;
  }

  // Sets the time of the events that follow, in the filter's own clock.
  void at(double time_s) {
    if (!std::isfinite(time_s)) fail_event("time_s is not finite");
    time_s_ = time_s;
  }

  // The first covariance. blocks: names and dimensions, in the state's order. point: the estimate,
  // in the filter's own numbers. charts: of blocks whose error is not added to their numbers.
  void prior(const std::vector<std::pair<std::string, std::size_t>>& blocks, const Matrix& P,
             const Vector& point = {}, const std::map<std::string, std::string>& charts = {}) {
    check_open();
    if (!order_.empty()) fail_event("is a second prior; a filter that begins anew has a new trace");
    Names names;
    std::string dims, named;
    std::size_t size = 0;
    std::unordered_map<std::string, Block> found;
    for (const auto& [name, dim] : blocks) {
      check_name(name);
      if (dim == 0 || dim > most_entries) fail_event("a block's dimension is out of range");
      const auto chart = charts.find(name);
      const Block block{dim, chart == charts.end() ? "additive" : chart->second};
      check_chart(block.chart);
      if (!found.emplace(name, block).second) {
        fail_event("block " + quoted(name) + " is given twice");
      }
      named += (named.empty() ? "" : ", ") + quoted(block.chart);
      names.push_back(name);
      dims += (dims.empty() ? "" : ", ") + std::to_string(dim);
      size += dim;
    }
    if (names.empty()) fail_event("a prior has no blocks");
    check_size(size);
    expect("P", P, size, size);
    order_ = names;
    dims_ = found;
    size_ = size;
    put(kind_prior, text(json(names)), {&P.values(), some(point)},
        text("[[" + dims + "], [" + named + "]]"));
  }

  // A prediction of some blocks: e' = F e + w, w ~ N(0, Q); both (n, n).
  void predict(const Matrix& F, const Matrix& Q, const Names& blocks = {},
               const About& about = {}) {
    const auto [spoken, n] = on(blocks);
    expect("F", F, n, n);
    expect("Q", Q, n, n);
    put(kind_predict, text(spoken), {&F.values(), &Q.values(), some(about.point), some(about.after)});
  }

  // A measurement that the filter used: residual = H e + v, v ~ N(0, R), residual = measured minus
  // predicted (m), H (m, n), R (m, m). correction: (N) what was added to the estimate of all
  // blocks; gain: (N, m). Both may be left empty.
  void update(const std::string& sensor, const Vector& residual, const Matrix& H, const Matrix& R,
              const Names& blocks = {}, const Vector& correction = {}, const Matrix& gain = {},
              const About& about = {}) {
    measured(sensor, residual, H, R, blocks, true, correction, gain, about);
  }

  // A measurement that the filter's gate rejected; arguments as of update().
  void reject(const std::string& sensor, const Vector& residual, const Matrix& H, const Matrix& R,
              const Names& blocks = {}, const About& about = {}) {
    measured(sensor, residual, H, R, blocks, false, {}, {}, about);
  }

  // A new block, behind all others: e_new = G_x e + G_z v, v ~ N(0, R). G_x (d, n), G_z (d, m).
  void augment(const std::string& name, const Matrix& G_x, const Matrix& G_z, const Matrix& R,
               const Names& blocks = {}, const About& about = {}) {
    const auto [spoken, n] = on(blocks);
    const std::size_t d = G_z.row_count(), m = G_z.column_count();
    if (d == 0) fail_event("G_z has no rows");
    check_new(name, d);
    check_chart(about.chart);
    expect("G_x", G_x, d, n);
    expect("R", R, m, m);
    const int at = text(spoken);
    add(name, {d, about.chart});
    const std::vector<double> weight(about.weight ? 1 : 0, about.weight.value_or(1.0));
    put(kind_augment, at,
        {&G_x.values(), &R.values(), &G_z.values(), some(about.point), some(about.after),
         some(about.numbers), weight.empty() ? nullptr : &weight},
        text("[" + quoted(name) + ", " + std::to_string(d) + ", " + quoted(about.chart) + "]"));
  }

  // A copy of a block, behind all others.
  void clone(const std::string& source, const std::string& name) {
    const auto [spoken, d] = on({source});
    check_new(name, d);
    const int at = text(spoken);
    add(name, dims_.at(source));
    put(kind_clone, at, {}, text(quoted(name)));
  }

  // Blocks that are marginalised out.
  void remove(const Names& names) {
    if (names.empty()) fail_event("a removal has no blocks");
    const auto [spoken, n] = on(names);
    if (names.size() == order_.size()) fail_event("removes the last block of the state");
    const int at = text(spoken);
    for (const std::string& name : names) {
      dims_.erase(name);
      order_.erase(std::find(order_.begin(), order_.end(), name));
    }
    size_ -= n;
    put(kind_remove, at, {});
  }

  // The error is expressed anew, as after an error-state correction: e' = J e, J (n, n).
  void reset(const Matrix& J, const Names& blocks = {}) {
    const auto [spoken, n] = on(blocks);
    expect("J", J, n, n);
    put(kind_reset, text(spoken), {&J.values()});
  }

  // The covariance of a block is set to P (d, d) on purpose, as where a bias starts anew: its error
  // is independent of all others, as after a prediction with F = 0 and Q = P. about.after: its
  // numbers from now on.
  void renew(const std::string& block, const Matrix& P, const About& about = {}) {
    const std::size_t d = on({block}).second;
    expect("P", P, d, d);
    const std::vector<double> nothing(d * d, 0.0);
    predict(Matrix(nothing.data(), d, d), P, {block}, about);
  }

  // The filter's covariance (n, n) after the last event. mean: the estimate, in the filter's own
  // numbers; error: (n) truth minus estimate. Both may be left empty.
  void snapshot(const Matrix& P, const Names& blocks = {}, const Vector& mean = {},
                const Vector& error = {}) {
    const auto [spoken, n] = on(blocks);
    expect("P", P, n, n);
    if (!error.values().empty()) expect("error", error, n);
    ++snapshots_;
    put(kind_snapshot, text(spoken), {&P.values(), some(mean), some(error)});
  }

  // Directions (n) of the error that some sensors cannot tell, by name: once, at the beginning.
  void directions(const std::vector<std::pair<std::string, Vector>>& basis, const Names& blind,
                  const Names& blocks = {}) {
    const auto [spoken, n] = on(blocks);
    if (basis.empty() || blind.empty()) fail_event("directions or sensors are missing");
    Names names;
    std::vector<double> columns(n * basis.size());
    for (std::size_t k = 0; k < basis.size(); ++k) {
      names.push_back(basis[k].first);
      expect("basis", basis[k].second, n);
      for (std::size_t i = 0; i < n; ++i) {
        columns[i * basis.size() + k] = basis[k].second.values()[i];
      }
    }
    check_distinct(names);
    check_distinct(blind);
    put(kind_directions, text(spoken), {&columns},
        text("{\"names\": " + json(names) + ", \"blind\": " + json(blind) + "}"));
  }

 private:
  // In the order of docs/audit-format.md.
  enum Kind : std::uint8_t {
    kind_prior, kind_predict, kind_update, kind_augment, kind_clone, kind_remove, kind_reset,
    kind_snapshot, kind_directions
  };
  using Numbers = std::vector<double>;
  static constexpr std::size_t most_entries = 20000, commit_events = 2000, most_columns = 8;
  static constexpr std::size_t commit_bytes = std::size_t{1} << 24;

  struct Block {
    std::size_t dim;
    std::string chart;
  };

  // A row of a batch's table.
  struct Row {
    double time_s;
    std::uint8_t kind, used, nothing[2];
    std::int32_t blocks, text, matrices[most_columns], rest;
  };
  static_assert(sizeof(Row) == 56, "a row has no gaps");

  void open(const std::vector<Sensor>& sensors, bool synced) {
    process_ = this_process();
    const std::string raw = ".events";
    if (path_.size() > raw.size() &&
        path_.compare(path_.size() - raw.size(), raw.size(), raw) == 0) {
      std::string described = "[";
      for (const Sensor& one : sensors) {
        char gate[32] = "null";
        if (one.gate) std::snprintf(gate, sizeof gate, "%.17g", *one.gate);
        described += (described.size() > 1 ? ", [" : "[") + quoted(one.name) + ", " + gate + ", " +
                     (one.components.empty() ? "null" : json(one.components)) + "]";
      }
      writing([&] {
        raw_ = std::make_unique<detail::RawFile>(path_, padded(described + "]", ' '), synced);
      });
      return;
    }
#ifdef SLAMCHECK_NO_SQLITE
    fail("expected a name that ends in .events, for there is no SQLite");
#else
    writing([&] {
      database_ = std::make_unique<detail::Database>(path_, synced);
      for (const Sensor& one : sensors) {
        const std::string parts = one.components.empty() ? "" : json(one.components);
        database_->sensor(one.name, one.gate, parts);
      }
      database_->commit();
    });
#endif
  }

  void measured(const std::string& sensor, const Vector& residual, const Matrix& H,
                const Matrix& R, const Names& blocks, bool used, const Vector& correction,
                const Matrix& gain, const About& about) {
    check_name(sensor);
    const auto [spoken, n] = on(blocks);
    const std::size_t m = residual.values().size();
    if (m == 0) fail_event("residual is empty");
    expect("H", H, m, n);
    expect("R", R, m, m);
    if (!correction.values().empty()) expect("correction", correction, size_);
    if (!gain.values().empty()) expect("gain", gain, size_, m);
    ++updates_;
    const Numbers weight(about.weight ? 1 : 0, about.weight.value_or(1.0));
    put(kind_update, text(spoken),
        {&residual.values(), &H.values(), &R.values(), some(correction),
         gain.values().empty() ? nullptr : &gain.values(), some(about.point), some(about.numbers),
         weight.empty() ? nullptr : &weight},
        text(quoted(sensor)), used);
  }

  static const Numbers* some(const Vector& vector) {
    return vector.values().empty() ? nullptr : &vector.values();
  }

  // Records an event. blocks, own: texts of the batch. matrices: null for those that are not there.
  void put(Kind kind, int blocks, std::initializer_list<const Numbers*> matrices, int own = -1,
           bool used = false) {
    Row row{};
    row.time_s = time_s_.value_or(std::numeric_limits<double>::quiet_NaN());
    row.kind = kind;
    row.used = used;
    row.blocks = blocks;
    row.text = own;
    std::fill(std::begin(row.matrices), std::end(row.matrices), -1);
    std::size_t column = 0;
    for (const Numbers* one : matrices) {
      if (one) row.matrices[column] = matrix(*one);
      ++column;
    }
    rows_.push_back(row);
    ++number_;
    if (rows_.size() >= commit_events || pending_bytes_ >= commit_bytes) commit();
  }

  // The index of a matrix in the batch, in which each is stored once.
  int matrix(const Numbers& values) {
    std::string bytes(8 * values.size(), '\0');
    if (!values.empty()) std::memcpy(bytes.data(), values.data(), bytes.size());
    const auto found = matrices_.emplace(std::move(bytes), static_cast<int>(stored_.size()));
    if (found.second) {
      stored_.push_back(&found.first->first);
      pending_bytes_ += 8 * values.size();
    }
    return found.first->second;
  }

  // The index of a text, in JSON, in the batch.
  int text(const std::string& spoken) {
    const auto found = texts_.emplace(spoken, static_cast<int>(spoken_.size()));
    if (found.second) spoken_.push_back(&found.first->first);
    return found.first->second;
  }

  // The batch as docs/audit-format.md has it.
  std::string pack() const {
    std::string spoken = "[";
    for (const std::string* one : spoken_) spoken += (spoken.size() > 1 ? "," : "") + *one;
    spoken += "]";
    const std::uint32_t head[4] = {static_cast<std::uint32_t>(rows_.size()),
                                   static_cast<std::uint32_t>(spoken.size()),
                                   static_cast<std::uint32_t>(stored_.size()), 0};
    std::string data(reinterpret_cast<const char*>(head), sizeof head);
    data.append(reinterpret_cast<const char*>(rows_.data()), sizeof(Row) * rows_.size());
    data += padded(spoken, '\0');
    std::string sizes;
    std::map<std::size_t, std::vector<const std::string*>> alike;
    for (const std::string* one : stored_) {
      const auto size = static_cast<std::uint32_t>(one->size() / 8);
      sizes.append(reinterpret_cast<const char*>(&size), sizeof size);
      if (size) alike[size].push_back(one);
    }
    data += padded(sizes, '\0');
    for (const auto& [size, ones] : alike) {
      std::string mask((ones.size() * size + 7) / 8, '\0'), fresh;
      std::size_t bit = 0;
      for (std::size_t k = 0; k < ones.size(); ++k) {
        for (std::size_t i = 0; i < size; ++i, ++bit) {
          const char* number = ones[k]->data() + 8 * i;
          if (k && std::memcmp(number, ones[k - 1]->data() + 8 * i, 8) == 0) continue;
          mask[bit / 8] = static_cast<char>(mask[bit / 8] | (1 << bit % 8));
          fresh.append(number, 8);
        }
      }
      data += padded(mask, '\0') + fresh;
    }
    return data;
  }

  static std::string padded(std::string bytes, char with) {
    bytes.append((8 - bytes.size() % 8) % 8, with);
    return bytes;
  }

  void add(const std::string& name, const Block& block) {
    order_.push_back(name);
    dims_[name] = block;
    size_ += block.dim;
  }

  void check_chart(const std::string& chart) const {
    for (const char* one : {"additive", "se2", "so3 left", "so3 right", "se23 left", "se23 right"}) {
      if (chart == one) return;
    }
    fail_event("there is no chart " + quoted(chart));
  }

  // Blocks as they are stored, and how many entries they have together.
  std::pair<std::string, std::size_t> on(const Names& blocks) const {
    check_open();
    if (order_.empty()) fail_event("is the first, expected the prior first");
    if (blocks.empty()) return {json(order_), size_};
    check_distinct(blocks);
    std::size_t size = 0;
    for (const std::string& name : blocks) {
      const auto found = dims_.find(name);
      if (found == dims_.end()) fail_event("block " + quoted(name) + " is not in the state");
      size += found->second.dim;
    }
    return {json(blocks), size};
  }

  void check_new(const std::string& name, std::size_t dim) const {
    check_name(name);
    if (dims_.count(name)) fail_event("block " + quoted(name) + " is in the state already");
    check_size(size_ + dim);
  }

  void check_size(std::size_t size) const {
    if (size > most_entries) fail_event("makes the state larger than 20000 entries");
  }

  void check_distinct(const Names& names) const {
    std::unordered_set<std::string> found;
    for (const std::string& name : names) {
      check_name(name);
      if (!found.insert(name).second) fail_event(quoted(name) + " is given twice");
    }
  }

  // Names are text in UTF-8, as SQLite's.
  void check_name(const std::string& name) const {
    for (std::size_t i = 0; i < name.size();) {
      const auto lead = static_cast<unsigned char>(name[i]);
      const std::size_t more = lead < 0x80 ? 0 : lead < 0xc2 ? 9 : lead < 0xe0 ? 1
                               : lead < 0xf0 ? 2 : lead < 0xf5 ? 3 : 9;
      std::uint32_t code = more == 0 ? lead : lead & (0x3fu >> more);
      bool sound = i + more < name.size();
      for (std::size_t k = 1; sound && k <= more; ++k) {
        const auto next = static_cast<unsigned char>(name[i + k]);
        sound = (next & 0xc0u) == 0x80;
        code = code << 6 | (next & 0x3fu);
      }
      const std::uint32_t least = more == 3 ? 0x10000 : more == 2 ? 0x800 : 0;
      if (!sound || code < least || code > 0x10ffff || (code >= 0xd800 && code < 0xe000)) {
        fail_event("a name is not text in UTF-8");
      }
      i += more + 1;
    }
  }

  void expect(const char* name, const Matrix& matrix, std::size_t rows, std::size_t cols) const {
    if (matrix.row_count() != rows || matrix.column_count() != cols) {
      fail_event(std::string(name) + " is " + shape(matrix.row_count(), matrix.column_count()) +
                 ", expected " + shape(rows, cols));
    }
  }

  void expect(const char* name, const Vector& vector, std::size_t size) const {
    if (vector.values().size() != size) {
      fail_event(std::string(name) + " has " + std::to_string(vector.values().size()) +
                 " numbers, expected " + std::to_string(size));
    }
  }

  static std::string shape(std::size_t rows, std::size_t cols) {
    return std::to_string(rows) + " x " + std::to_string(cols);
  }

  static std::string quoted(const std::string& text) {
    std::string found = "\"";
    for (char c : text) {
      if (static_cast<unsigned char>(c) < 0x20) {
        char escape[8];
        std::snprintf(escape, sizeof escape, "\\u%04x", static_cast<unsigned>(c));
        found += escape;
      } else {
        if (c == '"' || c == '\\') found += '\\';
        found += c;
      }
    }
    return found + "\"";
  }

  static std::string json(const Names& names) {
    std::string found = "[";
    for (const std::string& name : names) found += (found.size() > 1 ? ", " : "") + quoted(name);
    return found + "]";
  }

  // A fault of the file ends the recording: a gap in its numbers would spoil it.
  template <class Write>
  void writing(const Write& write) {
    try {
      write();
    } catch (const std::runtime_error& error) {
      release();
      fail(std::string("cannot be written (") + error.what() +
           "); the recording ends before event " + std::to_string(first_));
    }
  }

  bool is_open() const {
#ifndef SLAMCHECK_NO_SQLITE
    if (database_) return true;
#endif
    return raw_ != nullptr;
  }

  void check_open() const {
    if (!is_open()) fail("is closed");
    if (process_ != this_process()) {
      fail("was opened by another process; after a fork only the parent records");
    }
  }

  // Closes without a commit; a child of a fork leaves its parent's file alone.
  void release() {
    const bool mine = process_ == this_process();
#ifndef SLAMCHECK_NO_SQLITE
    if (database_ && !mine) database_->abandon();
    database_.reset();
#endif
    if (raw_ && !mine) raw_->abandon();
    raw_.reset();
  }

  static long this_process() {
#if defined(__unix__) || defined(__APPLE__)
    return static_cast<long>(getpid());
#else
    return 1;
#endif
  }

  [[noreturn]] void fail(const std::string& fault) const {
    throw std::runtime_error(path_ + ": " + fault);
  }

  [[noreturn]] void fail_event(const std::string& fault) const {
    throw std::runtime_error(path_ + ", event " + std::to_string(number_) + ": " + fault);
  }

  std::string path_;
#ifndef SLAMCHECK_NO_SQLITE
  std::unique_ptr<detail::Database> database_;
#endif
  std::unique_ptr<detail::RawFile> raw_;
  long process_ = 0;
  std::int64_t number_ = 0, first_ = 0, updates_ = 0, snapshots_ = 0;
  std::size_t pending_bytes_ = 0;
  std::vector<Row> rows_;
  std::unordered_map<std::string, int> texts_, matrices_;
  std::vector<const std::string*> spoken_, stored_;
  std::optional<double> time_s_;
  Names order_;
  std::unordered_map<std::string, Block> dims_;
  std::size_t size_ = 0;
};

namespace detail {

template <class F, class = void>
struct HasStateMethods : std::false_type {};
template <class F>
struct HasStateMethods<F, std::void_t<decltype(std::declval<const F&>().x()),
                                      decltype(std::declval<const F&>().P())>> : std::true_type {};

}  // namespace detail

// A filter that is recorded without a change in it: call predict and update of this instead.
//
//   slamcheck::Recorded filter(mine, "run.trace", {{"position", 2}, {"velocity", 2}});
//   filter.record.at(time_s);
//   filter.predict(dt);
//   filter.update("gps", z);
//
// The filter has x and P, as members or as methods, predict and update, and as methods F and Q,
// which are given what predict is, and H, R and residual, which are given what update is, each
// before it. A snapshot of P follows each call. The error is added to x. The filter must outlive it.
template <class Filter>
class Recorded {
 public:
  Recorder record;

  // blocks: names and dimensions of the state's parts; without any, one, `state`.
  Recorded(Filter& filter, const std::string& path,
           std::vector<std::pair<std::string, std::size_t>> blocks = {},
           const std::vector<Sensor>& sensors = {})
      : record(path, sensors), filter_(filter) {
    const Matrix P = covariance();
    if (blocks.empty()) blocks.emplace_back("state", P.row_count());
    record.prior(blocks, P, state());
    snapshot();
  }

  template <class... Given>
  auto predict(const Given&... given) {
    const Matrix F = filter_.F(given...), Q = filter_.Q(given...);
    About about;
    about.point = state();
    return followed([&] { return filter_.predict(given...); }, [&] {
      about.after = state();
      record.predict(F, Q, {}, about);
    });
  }

  // sensor: its name; the filter's update is given what follows it.
  template <class... Given>
  auto update(const std::string& sensor, const Given&... given) {
    const Matrix H = filter_.H(given...), R = filter_.R(given...);
    const Vector residual = filter_.residual(given...);
    About about;
    about.point = state();
    return followed([&] { return filter_.update(given...); }, [&] {
      std::vector<double> added = state().values();
      for (std::size_t i = 0; i < added.size(); ++i) added[i] -= about.point.values()[i];
      record.update(sensor, residual, H, R, {}, added, {}, about);
    });
  }

 private:
  // Calls the filter, then records, and returns what the filter does.
  template <class Call, class Then>
  auto followed(const Call& call, const Then& then) {
    if constexpr (std::is_void_v<decltype(call())>) {
      call();
      then();
      snapshot();
    } else {
      auto found = call();
      then();
      snapshot();
      return found;
    }
  }

  void snapshot() { record.snapshot(covariance(), {}, state()); }

  Vector state() const {
    if constexpr (detail::HasStateMethods<Filter>::value) {
      return filter_.x();
    } else {
      return filter_.x;
    }
  }

  Matrix covariance() const {
    if constexpr (detail::HasStateMethods<Filter>::value) {
      return filter_.P();
    } else {
      return filter_.P;
    }
  }

  Filter& filter_;
};

}  // namespace slamcheck
