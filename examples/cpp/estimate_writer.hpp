// Writes an estimate folder that `slamcheck check` and `slamcheck montecarlo` read. C++17, header
// only, no dependencies. The folder appears whole or not at all: it is filled under another name
// and renamed in the end.
#pragma once

#include <array>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <locale>
#include <random>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>
#include <cmath>

namespace slamcheck {

// What an estimator says; only times and poses are needed. Covariances are of the additive error in
// the world's frame and row by row. Units: s, m, rad; headings count counter-clockwise from east.
struct Estimate {
  std::vector<double> time_s;                          // K, increasing
  std::vector<std::array<double, 3>> pose;             // K: x, y, heading
  std::vector<std::array<double, 9>> pose_covariance;  // K, or none
  std::vector<std::int64_t> landmark_id;               // L, as in the log's measurements.csv
  std::vector<std::array<double, 2>> landmark;         // L: x, y
  std::vector<double> joint_covariance;  // n * n, n = 3 + 2 L: last pose, landmarks; or none
  std::string information = "filtered";  // filtered, smoothed or fixed-lag
  std::string estimator = "other";       // ekf, smoother or other
};

namespace detail {

inline void append(std::string& bytes, std::uint64_t value, int count) {
  for (int i = 0; i < count; ++i) bytes.push_back(static_cast<char>(value >> (8 * i) & 0xff));
}

inline std::uint32_t crc32(const std::string& bytes) {
  std::uint32_t crc = 0xffffffffu;
  for (unsigned char byte : bytes) {
    crc ^= byte;
    for (int bit = 0; bit < 8; ++bit) crc = crc >> 1 ^ (crc & 1u ? 0xedb88320u : 0u);
  }
  return ~crc;
}

// An array of doubles as numpy stores it.
inline std::string npy(const std::vector<std::size_t>& shape, const double* values) {
  std::string axes;
  std::size_t count = 1;
  for (std::size_t axis : shape) {
    axes += std::to_string(axis) + ",";
    count *= axis;
  }
  std::string head = "{'descr': '<f8', 'fortran_order': False, 'shape': (" + axes + "), }";
  head.append(63 - (head.size() + 10) % 64, ' ').push_back('\n');
  std::string bytes("\x93NUMPY\x01\x00", 8);
  append(bytes, head.size(), 2);
  bytes += head;
  bytes.reserve(bytes.size() + 8 * count);
  for (std::size_t i = 0; i < count; ++i) {
    std::uint64_t bits;
    std::memcpy(&bits, values + i, 8);
    append(bytes, bits, 8);
  }
  return bytes;
}

// A zip archive whose entries are stored, which is what numpy calls npz.
inline std::string zip(const std::vector<std::pair<std::string, std::string>>& entries) {
  std::string bytes, directory;
  for (const auto& [name, data] : entries) {
    const std::uint64_t offset = bytes.size();
    if (offset + data.size() > 0xf0000000u) throw std::length_error("covariances beyond 4 GiB");
    std::string about;
    append(about, 20, 2);                         // version that is needed
    append(about, 0, 2);                          // flags
    append(about, 0, 2);                          // stored
    append(about, 0, 2);                          // time
    append(about, 0x21, 2);                       // date: 1980-01-01
    append(about, crc32(data), 4);
    append(about, data.size(), 4);
    append(about, data.size(), 4);
    append(about, name.size(), 2);
    append(about, 0, 2);                          // extra
    append(bytes, 0x04034b50, 4);
    bytes += about + name + data;
    append(directory, 0x02014b50, 4);
    append(directory, 20, 2);                     // version that made it
    directory += about;
    append(directory, 0, 2);                      // comment
    append(directory, 0, 2);                      // disk
    append(directory, 0, 2);                      // kind
    append(directory, 0, 4);                      // attributes
    append(directory, offset, 4);
    directory += name;
  }
  const std::uint64_t begin = bytes.size();
  bytes += directory;
  append(bytes, 0x06054b50, 4);
  append(bytes, 0, 4);                            // disks
  append(bytes, entries.size(), 2);
  append(bytes, entries.size(), 2);
  append(bytes, directory.size(), 4);
  append(bytes, begin, 4);
  append(bytes, 0, 2);
  return bytes;
}

inline void save(const std::filesystem::path& path, const std::string& bytes) {
  std::ofstream file(path, std::ios::binary);
  file << bytes;
  file.close();
  if (!file) throw std::runtime_error("cannot be written: " + path.string());
}

// Numbers that read back to the same bits, whichever the locale.
inline std::ostringstream text() {
  std::ostringstream out;
  out.imbue(std::locale::classic());
  out.precision(std::numeric_limits<double>::max_digits10);
  return out;
}

inline void check(const Estimate& e) {
  const std::size_t n = 3 + 2 * e.landmark.size();
  auto need = [](bool right, const char* fault) {
    if (!right) throw std::invalid_argument(fault);
  };
  need(!e.pose.empty() && e.pose.size() == e.time_s.size(), "pose: expected one per time_s");
  need(e.pose_covariance.empty() || e.pose_covariance.size() == e.pose.size(),
       "pose_covariance: expected one per pose, or none");
  need(e.landmark.size() == e.landmark_id.size(), "landmark: expected one per landmark_id");
  need(e.joint_covariance.empty() || e.joint_covariance.size() == n * n,
       "joint_covariance: expected (3 + 2 L)^2 numbers, or none");
}

inline void fill(const Estimate& e, const std::filesystem::path& folder) {
  auto path = text(), places = text();
  for (std::size_t k = 0; k < e.pose.size(); ++k) {
    const auto& [x, y, heading] = e.pose[k];
    path << e.time_s[k] << ' ' << x << ' ' << y << " 0 0 0 " << std::sin(heading / 2) << ' '
         << std::cos(heading / 2) << '\n';
  }
  save(folder / "trajectory.tum", path.str());
  places << "id,x_m,y_m\n";
  for (std::size_t i = 0; i < e.landmark.size(); ++i)
    places << e.landmark_id[i] << ',' << e.landmark[i][0] << ',' << e.landmark[i][1] << '\n';
  if (!e.landmark.empty()) save(folder / "landmarks.csv", places.str());
  std::vector<std::pair<std::string, std::string>> arrays;
  if (!e.pose_covariance.empty())
    arrays.emplace_back("pose.npy", npy({e.pose.size(), 3, 3}, e.pose_covariance[0].data()));
  const std::size_t n = 3 + 2 * e.landmark.size();
  if (!e.joint_covariance.empty())
    arrays.emplace_back("last_pose_and_landmarks.npy", npy({n, n}, e.joint_covariance.data()));
  if (!arrays.empty()) save(folder / "covariances.npz", zip(arrays));
  save(folder / "estimate.toml", "version = 1\ninformation = \"" + e.information +
                                     "\"\nestimator = \"" + e.estimator + "\"\n");
}

}  // namespace detail

// Throws std::invalid_argument for arrays that do not fit each other, and std::runtime_error where
// the folder exists or cannot be written.
inline void write_estimate(const Estimate& estimate, const std::filesystem::path& folder) {
  namespace fs = std::filesystem;
  detail::check(estimate);
  if (fs::exists(folder)) throw std::runtime_error("already exists: " + folder.string());
  const fs::path target = fs::absolute(folder);
  const fs::path part = target.parent_path() / ("." + target.filename().string() + ".part-" +
                                                std::to_string(std::random_device{}()));
  fs::create_directories(part);
  try {
    detail::fill(estimate, part);
    fs::rename(part, target);
  } catch (...) {
    std::error_code ignored;
    fs::remove_all(part, ignored);
    throw;
  }
}

}  // namespace slamcheck
