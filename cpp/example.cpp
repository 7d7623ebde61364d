// A target in the plane, tracked by an extended Kalman filter and recorded for `slamcheck audit`.
//
//   c++ -std=c++17 example.cpp -o example -lsqlite3
//   ./example run.trace
//   slamcheck audit run.trace
//
// Constant velocity with random accelerations; range and bearing to a beacon at a known place, with
// a gate that rejects one wrong range; and stochastic cloning: a copy of the position stays behind
// as "anchor", the way since then is measured, and the copy is removed again.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <exception>
#include <iostream>
#include <vector>

#include "slamcheck_recorder.hpp"

namespace {

// Column by column, as Eigen's matrices are by default; the recorder asks for entries.
class Mat {
 public:
  Mat(std::size_t rows, std::size_t cols) : rows_(rows), cols_(cols), values_(rows * cols) {}
  std::size_t rows() const { return rows_; }
  std::size_t cols() const { return cols_; }
  std::size_t size() const { return rows_ * cols_; }
  double& operator()(std::size_t i, std::size_t j) { return values_[j * rows_ + i]; }
  double operator()(std::size_t i, std::size_t j) const { return values_[j * rows_ + i]; }

 private:
  std::size_t rows_, cols_;
  std::vector<double> values_;
};

Mat diagonal(const std::vector<double>& entries) {
  Mat found(entries.size(), entries.size());
  for (std::size_t i = 0; i < entries.size(); ++i) found(i, i) = entries[i];
  return found;
}

Mat operator*(const Mat& a, const Mat& b) {
  Mat found(a.rows(), b.cols());
  for (std::size_t i = 0; i < a.rows(); ++i) {
    for (std::size_t j = 0; j < b.cols(); ++j) {
      for (std::size_t k = 0; k < a.cols(); ++k) found(i, j) += a(i, k) * b(k, j);
    }
  }
  return found;
}

Mat transposed(const Mat& a) {
  Mat found(a.cols(), a.rows());
  for (std::size_t i = 0; i < a.rows(); ++i) {
    for (std::size_t j = 0; j < a.cols(); ++j) found(j, i) = a(i, j);
  }
  return found;
}

Mat sum(const Mat& a, const Mat& b, double factor = 1.0) {
  Mat found = a;
  for (std::size_t i = 0; i < a.rows(); ++i) {
    for (std::size_t j = 0; j < a.cols(); ++j) found(i, j) += factor * b(i, j);
  }
  return found;
}

Mat inverse_2x2(const Mat& a) {
  const double determinant = a(0, 0) * a(1, 1) - a(0, 1) * a(1, 0);
  Mat found(2, 2);
  found(0, 0) = a(1, 1) / determinant;
  found(1, 1) = a(0, 0) / determinant;
  found(0, 1) = -a(0, 1) / determinant;
  found(1, 0) = -a(1, 0) / determinant;
  return found;
}

// The first entries of a state, or of its covariance, as they are; others are new.
Mat resized(const Mat& a, std::size_t rows, std::size_t cols) {
  Mat found(rows, cols);
  for (std::size_t i = 0; i < std::min(rows, a.rows()); ++i) {
    for (std::size_t j = 0; j < std::min(cols, a.cols()); ++j) found(i, j) = a(i, j);
  }
  return found;
}

// The same numbers on every machine: twelve uniform ones make a normal one, nearly.
class Noise {
 public:
  double operator()(double sigma) {
    double total = -6.0;
    for (int i = 0; i < 12; ++i) {
      state_ = state_ * 6364136223846793005u + 1442695040888963407u;
      total += static_cast<double>(state_ >> 11) / 9007199254740992.0;
    }
    return sigma * total;
  }

 private:
  std::uint64_t state_ = 7;
};

constexpr double pi = 3.14159265358979323846;
constexpr double step_s = 0.1, sigma_acceleration = 0.5;
constexpr double sigma_range = 0.1, sigma_bearing = 0.02, sigma_way = 0.05;
constexpr double beacon_x = 3.0, beacon_y = -4.0;
constexpr double gate_2dof = 9.2103403719761836;  // 99 %

double wrapped(double angle) { return angle - 2.0 * pi * std::round(angle / (2.0 * pi)); }

struct Filter {
  Mat x = Mat(4, 1);
  Mat P = diagonal({1.0, 1.0, 0.25, 0.25});

  Mat innovation_inverse(const Mat& H, const Mat& R) const {
    return inverse_2x2(sum(H * P * transposed(H), R));
  }

  // P = (I - K H) P (I - K H)' + K R K', Joseph's form. Returns the gain.
  Mat correct(const Mat& residual, const Mat& H, const Mat& R) {
    const Mat K = P * transposed(H) * innovation_inverse(H, R);
    const Mat rest = sum(diagonal(std::vector<double>(x.rows(), 1.0)), K * H, -1.0);
    x = sum(x, K * residual);
    P = sum(rest * P * transposed(rest), K * R * transposed(K));
    return K;
  }
};

void run(const std::string& path) {
  slamcheck::Recorder record(path, {{"beacon", 0.99, {"range", "bearing"}}});
  Noise noise;
  Filter filter;
  Mat truth(4, 1);
  for (std::size_t i = 0; i < 4; ++i) {
    filter.x(i, 0) = i < 2 ? 0.0 : 1.0;
    truth(i, 0) = filter.x(i, 0) + noise(std::sqrt(filter.P(i, i)));
  }
  std::array<double, 2> anchor{};
  record.prior({{"position", 2}, {"velocity", 2}}, filter.P);

  for (int step = 1; step <= 300; ++step) {
    record.at(step * step_s);
    Mat F = diagonal({1.0, 1.0, 1.0, 1.0}), G(4, 2);
    for (std::size_t i = 0; i < 2; ++i) {
      F(i, i + 2) = step_s;
      G(i, i) = 0.5 * step_s * step_s;
      G(i + 2, i) = step_s;
    }
    Mat acceleration(2, 1);
    for (std::size_t i = 0; i < 2; ++i) acceleration(i, 0) = noise(sigma_acceleration);
    truth = sum(F * truth, G * acceleration);

    const Mat Q = G * diagonal({0.25, 0.25}) * transposed(G);
    const std::size_t size = filter.x.rows();
    Mat F_all = diagonal(std::vector<double>(size, 1.0)), Q_all = resized(Q, size, size);
    for (std::size_t i = 0; i < 2; ++i) F_all(i, i + 2) = step_s;
    filter.x = F_all * filter.x;
    filter.P = sum(F_all * filter.P * transposed(F_all), Q_all);
    record.predict(F, Q, {"position", "velocity"});

    if (step % 5 == 0) {
      const double true_x = beacon_x - truth(0, 0), true_y = beacon_y - truth(1, 0);
      const double wrong = step == 150 ? 2.0 : 0.0;
      const double range = std::hypot(true_x, true_y) + noise(sigma_range) + wrong;
      const double bearing = std::atan2(true_y, true_x) + noise(sigma_bearing);
      const double dx = beacon_x - filter.x(0, 0), dy = beacon_y - filter.x(1, 0);
      const double q = dx * dx + dy * dy, r = std::sqrt(q);
      Mat residual(2, 1), H(2, size), H_position(2, 2);
      residual(0, 0) = range - r;
      residual(1, 0) = wrapped(bearing - std::atan2(dy, dx));
      H(0, 0) = H_position(0, 0) = -dx / r;
      H(0, 1) = H_position(0, 1) = -dy / r;
      H(1, 0) = H_position(1, 0) = dy / q;
      H(1, 1) = H_position(1, 1) = -dx / q;
      const Mat R = diagonal({sigma_range * sigma_range, sigma_bearing * sigma_bearing});
      const Mat nis = transposed(residual) * filter.innovation_inverse(H, R) * residual;
      if (nis(0, 0) < gate_2dof) {
        const Mat K = filter.correct(residual, H, R);
        record.update("beacon", residual, H_position, R, {"position"}, K * residual, K);
      } else {
        record.reject("beacon", residual, H_position, R, {"position"});
      }
    }

    if (step % 20 == 10) {  // the position is cloned behind the others
      filter.x = resized(filter.x, 6, 1);
      filter.P = resized(filter.P, 6, 6);
      for (std::size_t i = 0; i < 2; ++i) {
        filter.x(i + 4, 0) = filter.x(i, 0);
        anchor[i] = truth(i, 0);
        for (std::size_t j = 0; j < 4; ++j) filter.P(i + 4, j) = filter.P(j, i + 4) = filter.P(i, j);
      }
      for (std::size_t i = 0; i < 2; ++i) {
        for (std::size_t j = 0; j < 2; ++j) filter.P(i + 4, j + 4) = filter.P(i, j);
      }
      record.clone("position", "anchor");
    }

    if (step % 20 == 0 && size == 6) {  // the way since then is measured, and the clone leaves
      Mat residual(2, 1), H(2, 6), H_blocks(2, 4);
      for (std::size_t i = 0; i < 2; ++i) {
        residual(i, 0) = truth(i, 0) - anchor[i] + noise(sigma_way);
        residual(i, 0) -= filter.x(i, 0) - filter.x(i + 4, 0);
        H(i, i) = H_blocks(i, i) = 1.0;
        H(i, i + 4) = H_blocks(i, i + 2) = -1.0;
      }
      const Mat R = diagonal({sigma_way * sigma_way, sigma_way * sigma_way});
      filter.correct(residual, H, R);
      record.update("way", residual, H_blocks, R, {"position", "anchor"});
      record.snapshot(filter.P);
      filter.x = resized(filter.x, 4, 1);
      filter.P = resized(filter.P, 4, 4);
      record.remove({"anchor"});
      record.snapshot(filter.P, {}, filter.x, sum(truth, filter.x, -1.0));
    }
  }
  record.close();
}

}  // namespace

int main(int count, char** words) {
  if (count != 2) {
    std::cerr << "usage: example TRACE\n";
    return 2;
  }
  try {
    run(words[1]);
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 2;
  }
}
