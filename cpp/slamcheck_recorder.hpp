// Records what a Kalman filter does, for `slamcheck audit`. C++17, this header and sqlite3 alone:
//
//   c++ -std=c++17 filter.cpp -lsqlite3
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

#include <sqlite3.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <initializer_list>
#include <limits>
#include <map>
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

class Recorder {
 public:
  using Names = std::vector<std::string>;

  // Starts a file, which must not exist.
  explicit Recorder(const std::string& path, const std::vector<Sensor>& sensors = {})
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
      open(sensors);
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
    if (!file_) return;
    commit();
    release();
  }

  // Writes what is recorded so far; it is done by itself every 2,000 events or 16 MiB.
  void commit() {
    check_open();
    if (pending_) execute("COMMIT");
    pending_ = pending_bytes_ = 0;
  }

  // Sets the time of the events that follow, in the filter's own clock.
  void at(double time_s) {
    if (!std::isfinite(time_s)) fail_event("time_s is not finite");
    time_s_ = time_s;
  }

  // The first covariance. blocks: names and dimensions, in the state's order.
  void prior(const std::vector<std::pair<std::string, std::size_t>>& blocks, const Matrix& P) {
    check_open();
    if (!order_.empty()) fail_event("is a second prior; a filter that begins anew has a new trace");
    Names names;
    std::string dims;
    std::size_t size = 0;
    std::unordered_map<std::string, std::size_t> found;
    for (const auto& [name, dim] : blocks) {
      check_name(name);
      if (dim == 0 || dim > most_entries) fail_event("a block's dimension is out of range");
      if (!found.emplace(name, dim).second) fail_event("block " + quoted(name) + " is given twice");
      names.push_back(name);
      dims += (dims.empty() ? "" : ", ") + std::to_string(dim);
      size += dim;
    }
    if (names.empty()) fail_event("a prior has no blocks");
    check_size(size);
    expect("P", P, size, size);
    Row row = start("prior", json(names));
    row.blob(covariance, P.values());
    row.text(note, "[" + dims + "]");
    finish(row);
    order_ = names;
    dims_ = found;
    size_ = size;
  }

  // A prediction of some blocks: e' = F e + w, w ~ N(0, Q); both (n, n).
  void predict(const Matrix& F, const Matrix& Q, const Names& blocks = {}) {
    const auto [text, n] = on(blocks);
    expect("F", F, n, n);
    expect("Q", Q, n, n);
    Row row = start("predict", text);
    repeated(row, "predict", "", text, {{jacobian, &F}, {noise, &Q}});
    finish(row);
  }

  // A measurement that the filter used: residual = H e + v, v ~ N(0, R), residual = measured minus
  // predicted (m), H (m, n), R (m, m). correction: (N) what was added to the estimate of all
  // blocks; gain: (N, m). Both may be left empty.
  void update(const std::string& sensor, const Vector& residual, const Matrix& H, const Matrix& R,
              const Names& blocks = {}, const Vector& correction = {}, const Matrix& gain = {}) {
    measured(sensor, residual, H, R, blocks, true, correction, gain);
  }

  // A measurement that the filter's gate rejected; arguments as of update().
  void reject(const std::string& sensor, const Vector& residual, const Matrix& H, const Matrix& R,
              const Names& blocks = {}) {
    measured(sensor, residual, H, R, blocks, false, {}, {});
  }

  // A new block, behind all others: e_new = G_x e + G_z v, v ~ N(0, R). G_x (d, n), G_z (d, m).
  void augment(const std::string& name, const Matrix& G_x, const Matrix& G_z, const Matrix& R,
               const Names& blocks = {}) {
    const auto [text, n] = on(blocks);
    const std::size_t d = G_z.row_count(), m = G_z.column_count();
    if (d == 0) fail_event("G_z has no rows");
    check_new(name, d);
    expect("G_x", G_x, d, n);
    expect("R", R, m, m);
    Row row = start("augment", text);
    repeated(row, "augment", "", text, {{jacobian, &G_x}, {noise, &R}, {noise_jacobian, &G_z}});
    row.text(note, "[" + quoted(name) + ", " + std::to_string(d) + "]");
    finish(row);
    add(name, d);
  }

  // A copy of a block, behind all others.
  void clone(const std::string& source, const std::string& name) {
    const auto [text, d] = on({source});
    check_new(name, d);
    Row row = start("clone", text);
    row.text(note, name);
    finish(row);
    add(name, d);
  }

  // Blocks that are marginalised out.
  void remove(const Names& names) {
    if (names.empty()) fail_event("a removal has no blocks");
    const auto [text, n] = on(names);
    if (names.size() == order_.size()) fail_event("removes the last block of the state");
    Row row = start("remove", text);
    finish(row);
    for (const std::string& name : names) {
      dims_.erase(name);
      order_.erase(std::find(order_.begin(), order_.end(), name));
    }
    size_ -= n;
    last_.clear();  // a block of this name may begin with another dimension
  }

  // The error is expressed anew, as after an error-state correction: e' = J e, J (n, n).
  void reset(const Matrix& J, const Names& blocks = {}) {
    const auto [text, n] = on(blocks);
    expect("J", J, n, n);
    Row row = start("reset", text);
    repeated(row, "reset", "", text, {{jacobian, &J}});
    finish(row);
  }

  // The filter's covariance (n, n) after the last event. mean: the estimate, in the filter's own
  // numbers; error: (n) truth minus estimate. Both may be left empty.
  void snapshot(const Matrix& P, const Names& blocks = {}, const Vector& mean = {},
                const Vector& error = {}) {
    const auto [text, n] = on(blocks);
    expect("P", P, n, n);
    if (!error.values().empty()) expect("error", error, n);
    Row row = start("snapshot", text);
    row.blob(covariance, P.values());
    if (!mean.values().empty()) row.blob(mean_column, mean.values());
    if (!error.values().empty()) row.blob(error_column, error.values());
    finish(row);
  }

  // Directions (n) of the error that some sensors cannot tell, by name: once, at the beginning.
  void directions(const std::vector<std::pair<std::string, Vector>>& basis, const Names& blind,
                  const Names& blocks = {}) {
    const auto [text, n] = on(blocks);
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
    Row row = start("directions", text);
    row.blob(jacobian, columns);
    row.text(note, "{\"names\": " + json(names) + ", \"blind\": " + json(blind) + "}");
    finish(row);
  }

 private:
  // Columns of the table, counted from 1.
  enum Column {
    number_column = 1, kind_column, time_column, sensor_column, blocks_column, used_column,
    jacobian, noise, noise_jacobian, residual_column, correction_column, gain_column, covariance,
    mean_column, error_column, note
  };
  static constexpr std::size_t most_entries = 20000, commit_events = 2000;
  static constexpr std::size_t commit_bytes = std::size_t{1} << 24;

  // An event in the making: values of its columns, those left out are NULL.
  struct Row {
    sqlite3_stmt* insert;
    int status = SQLITE_OK;
    std::size_t bytes = 0;

    void took(int code) {
      if (status == SQLITE_OK) status = code;
    }
    void blob(Column column, const std::vector<double>& values) {
      static const double nothing = 0.0;
      const std::size_t size = 8 * values.size();
      const double* data = values.empty() ? &nothing : values.data();
      took(sqlite3_bind_blob64(insert, column, data, size, SQLITE_TRANSIENT));
      bytes += size;
    }
    void text(Column column, const std::string& value) {
      took(sqlite3_bind_text64(insert, column, value.data(), value.size(), SQLITE_TRANSIENT,
                               SQLITE_UTF8));
      bytes += value.size();
    }
  };

  // The matrices of the last event of a kind and sensor, and the blocks it was on.
  struct Last {
    std::string blocks;
    std::vector<std::vector<double>> matrices;
  };

  void open(const std::vector<Sensor>& sensors) {
    const int flags = SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE;
    check(sqlite3_open_v2(path_.c_str(), &file_, flags, nullptr));
    sqlite3_busy_timeout(file_, 5000);
    execute("PRAGMA page_size = 32768; PRAGMA synchronous = OFF; PRAGMA cache_spill = OFF;"
            "PRAGMA application_id = 1397506388; PRAGMA user_version = 1");
    execute("BEGIN");
    execute("CREATE TABLE event (number INTEGER PRIMARY KEY, kind TEXT NOT NULL, time_s REAL, "
            "sensor TEXT, blocks TEXT NOT NULL, used INTEGER, jacobian BLOB, noise BLOB, "
            "noise_jacobian BLOB, residual BLOB, correction BLOB, gain BLOB, covariance BLOB, "
            "mean BLOB, error BLOB, note TEXT)");
    execute("CREATE TABLE sensor (name TEXT PRIMARY KEY, gate REAL, components TEXT)");
    check(prepare("INSERT OR REPLACE INTO sensor VALUES (?, ?, ?)"));
    for (const Sensor& one : sensors) {
      Row row{insert_};
      row.text(static_cast<Column>(1), one.name);
      if (one.gate) row.took(sqlite3_bind_double(insert_, 2, *one.gate));
      if (!one.components.empty()) row.text(static_cast<Column>(3), json(one.components));
      insert(row);
    }
    execute("COMMIT");
    sqlite3_finalize(insert_);
    insert_ = nullptr;
    check(prepare("INSERT INTO event VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"));
    process_ = this_process();
  }

  void measured(const std::string& sensor, const Vector& residual, const Matrix& H,
                const Matrix& R, const Names& blocks, bool used, const Vector& correction,
                const Matrix& gain) {
    check_name(sensor);
    const auto [text, n] = on(blocks);
    const std::size_t m = residual.values().size();
    if (m == 0) fail_event("residual is empty");
    expect("H", H, m, n);
    expect("R", R, m, m);
    if (!correction.values().empty()) expect("correction", correction, size_);
    if (!gain.values().empty()) expect("gain", gain, size_, m);
    Row row = start("update", text);
    row.text(sensor_column, sensor);
    row.took(sqlite3_bind_int(insert_, used_column, used));
    row.blob(residual_column, residual.values());
    if (!correction.values().empty()) row.blob(correction_column, correction.values());
    if (!gain.values().empty()) row.blob(gain_column, gain.values());
    repeated(row, "update", sensor, text, {{jacobian, &H}, {noise, &R}});
    finish(row);
  }

  // The event's row, with what all kinds have.
  Row start(const std::string& kind, const std::string& blocks) {
    sqlite3_clear_bindings(insert_);
    Row row{insert_};
    row.took(sqlite3_bind_int64(insert_, number_column, number_));
    row.text(kind_column, kind);
    if (time_s_) row.took(sqlite3_bind_double(insert_, time_column, *time_s_));
    row.text(blocks_column, blocks);
    return row;
  }

  // Binds matrices; NULL stands for one that the event before of this kind and sensor has had, if
  // that was on the same blocks.
  void repeated(Row& row, const std::string& kind, const std::string& sensor,
                const std::string& blocks,
                std::initializer_list<std::pair<Column, const Matrix*>> matrices) {
    Last& last = last_[{kind, sensor}];
    const bool same = last.blocks == blocks;
    last.matrices.resize(matrices.size());
    std::size_t k = 0;
    for (const auto& [column, matrix] : matrices) {
      if (!same || last.matrices[k] != matrix->values()) {
        row.blob(column, matrix->values());
        last.matrices[k] = matrix->values();
      }
      ++k;
    }
    last.blocks = blocks;
  }

  void finish(Row& row) {
    if (pending_ == 0) execute("BEGIN");
    insert(row);
    ++number_;
    ++pending_;
    pending_bytes_ += row.bytes;
    if (pending_ >= commit_events || pending_bytes_ >= commit_bytes) commit();
  }

  void insert(const Row& row) {
    check(row.status);
    const int code = sqlite3_step(insert_);
    sqlite3_reset(insert_);
    if (code != SQLITE_DONE) check(code);
  }

  void add(const std::string& name, std::size_t dim) {
    order_.push_back(name);
    dims_[name] = dim;
    size_ += dim;
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
      size += found->second;
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

  int prepare(const char* sql) {
    return sqlite3_prepare_v2(file_, sql, -1, &insert_, nullptr);
  }

  void execute(const char* sql) { check(sqlite3_exec(file_, sql, nullptr, nullptr, nullptr)); }

  // A fault of the file ends the recording: a gap in its numbers would spoil it.
  void check(int code) {
    if (code == SQLITE_OK) return;
    const std::string said = file_ ? sqlite3_errmsg(file_) : sqlite3_errstr(code);
    release();
    fail("cannot be written (" + said + "); the recording ends before event " +
         std::to_string(number_ - static_cast<std::int64_t>(pending_)));
  }

  void check_open() const {
    if (!file_) fail("is closed");
    if (process_ != this_process()) {
      fail("was opened by another process; after a fork only the parent records");
    }
  }

  // Closes without a commit; a child of a fork leaves its parent's file alone.
  void release() {
    if (process_ == this_process() || process_ == 0) {
      sqlite3_finalize(insert_);
      sqlite3_close(file_);
    }
    insert_ = nullptr;
    file_ = nullptr;
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
  sqlite3* file_ = nullptr;
  sqlite3_stmt* insert_ = nullptr;
  long process_ = 0;
  std::int64_t number_ = 0;
  std::size_t pending_ = 0, pending_bytes_ = 0;
  std::optional<double> time_s_;
  Names order_;
  std::unordered_map<std::string, std::size_t> dims_;
  std::size_t size_ = 0;
  std::map<std::pair<std::string, std::string>, Last> last_;
};

}  // namespace slamcheck
