// An example of estimate_writer.hpp: dead reckoning along a log's velocity odometry.
//
// c++ -std=c++17 -O2 -o write_estimate write_estimate.cpp
// ./write_estimate LOG OUT X Y HEADING     (where the log's [prior] starts)
#include "estimate_writer.hpp"

#include <cstdio>
#include <iostream>

int main(int count, char** words) {
  if (count != 6) {
    std::cerr << "usage: write_estimate LOG OUT X Y HEADING\n";
    return 2;
  }
  try {
    std::ifstream log(std::filesystem::path(words[1]) / "odometry.csv");
    std::string line;
    if (!std::getline(log, line) || line != "time_s,speed_mps,yaw_rate_radps")
      throw std::runtime_error("expected a log folder with velocity odometry");
    slamcheck::Estimate estimate;
    double x = std::stod(words[3]), y = std::stod(words[4]), heading = std::stod(words[5]);
    double last = 0, speed = 0, turn = 0, variance = 1e-9;
    for (double t, v, w; std::getline(log, line); last = t, speed = v, turn = w) {
      if (std::sscanf(line.c_str(), "%lf,%lf,%lf", &t, &v, &w) != 3)
        throw std::runtime_error("odometry.csv: expected three numbers: " + line);
      const double dt = t - last, middle = heading + turn * dt / 2;
      x += speed * dt * std::cos(middle);
      y += speed * dt * std::sin(middle);
      heading += turn * dt;
      variance += 1e-3 * dt;  // a guess: yours comes from your filter
      estimate.time_s.push_back(t);
      estimate.pose.push_back({x, y, heading});
      estimate.pose_covariance.push_back({variance, 0, 0, 0, variance, 0, 0, 0, variance});
    }
    slamcheck::write_estimate(estimate, words[2]);
  } catch (const std::exception& error) {
    std::cerr << "write_estimate: " << error.what() << '\n';
    return 1;
  }
}
