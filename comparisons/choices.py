"""The values that settings may take. Imports nothing heavy: the command line's help reads it."""

from __future__ import annotations

from typing import Literal

Filter = Literal["full", "compressed", "compressed-suboptimal", "misono", "misono-full"]
Association = Literal["known", "nn", "jcbb", "euclidean", "consensus"]
SolverAssociation = Literal["known", "own"]
Attributes = Literal["off", "on"]
Gps = Literal["off", "on", "half"]
Features = Literal["log", "trees"]
Sigmas = Literal["calibrated", "published"]
Method = Literal["batch", "isam2", "fixed-lag"]
Optimiser = Literal["levenberg-marquardt", "gauss-newton", "dogleg"]
Robust = Literal["none", "huber", "cauchy", "gnc"]
Guess = Literal["wheels", "none"]
LoopMatcher = Literal["surface", "kiss", "point-to-point", "point-to-plane", "generalised"]
CloudFormat = Literal["pcd", "ply"]
PictureFormat = Literal["png", "pdf"]
Motion = Literal["wheel", "scan", "both"]
Landmarks = Literal["points", "scans", "both"]
TemplateExtraction = Literal["whole-scan", "per-segment"]
Layer = Literal["points", "occupancy", "particles", "sog"]
RequiredGrade = Literal["equal", "like", "plausible"]
Peer = Literal["ekf", "own"]
SmootherMatcher = Literal["ekf", "generalised-icp"]
Posterior = Literal["none", "samples"]
FailOn = Literal["disagreement", "consistency", "both", "truth", "association"]
When = Literal["always", "never"]
Third = Literal["none", "fastslam"]
Preset = Literal["recommended", "as-published"]
