"""The options of all jobs, generated from their settings by `make settings`."""

# fmt: off
# ruff: noqa

from comparisons.options import Flag, Where

FLAGS: tuple[Flag, ...] = (
    Flag(option='--filter', panel='Estimators', help='EKF variant: full, compressed, compressed-suboptimal, misono (direction cosines) or misono-full. [full]', jobs=('run', 'map'), field='ekf.filter', words=('full', 'compressed', 'compressed-suboptimal', 'misono', 'misono-full')),
    Flag(option='--association', panel='Estimators', help='Association: known (labels), nn (nearest neighbour), jcbb (joint compatibility), euclidean, consensus (of hypotheses). [known, else nn]', jobs=('run', 'map'), field='ekf.association', words=('known', 'nn', 'jcbb', 'euclidean', 'consensus')),
    Flag(option='--attributes', jobs=('run',), field='ekf.attributes', words=('off', 'on')),
    Flag(option='--gps', panel='Estimators', help='GPS: off, on, half (every second minute held out). [off]', jobs=('run', 'map'), field='ekf.gps', words=('off', 'on', 'half')),
    Flag(option='--features', jobs=('run', 'solve', 'check', 'map'), field='log.features', words=('log', 'trees')),
    Flag(option='--landmarks', panel='Scans and dense maps', help='Landmarks: points, scans (Scan-SLAM), or both. [points]', jobs=('run', 'map'), settings={'points': None, 'scans': {'landmarks': 'scans'}, 'both': {'landmarks': 'both'}}, field='extensions.scan_landmarks', words=('points', 'scans', 'both')),
    Flag(option='--template-extraction', jobs=('run', 'map'), within='--landmarks scans or both', field='extensions.scan_landmarks.template_extraction', words=('whole-scan', 'per-segment')),
    Flag(option='--merge-landmarks', jobs=('run',), within='--landmarks scans or both', off=True, field='extensions.scan_landmarks.merge_landmarks', kind=bool, neutral=False),
    Flag(option='--motion', panel='Scans and dense maps', help='Motion: wheel, scan (scan matching), or both. [wheel]', jobs=('run',), settings={'wheel': None, 'scan': {'motion': 'scan'}, 'both': {'motion': 'both'}}, field='extensions.scan_motion', words=('wheel', 'scan', 'both')),
    Flag(option='--smoother-association', jobs=('run',), settings={'ekf': {'when': 'never'}, 'own': {'when': 'always'}}, field='extensions.own_association', words=('ekf', 'own')),
    Flag(option='--smoother-matcher', jobs=('run',), settings={'ekf': None, 'generalised-icp': {}}, field='extensions.own_matching', words=('ekf', 'generalised-icp')),
    Flag(option='--posterior', jobs=('run',), settings={'none': None, 'samples': {}}, field='extensions.posterior', words=('none', 'samples')),
    Flag(option='--dense', panel='Scans and dense maps', help='Dense map layer (repeatable): points, occupancy, particles or sog (sum of Gaussians).', jobs=('run',), field='extensions.dense_maps.layers', words=('points', 'occupancy', 'particles', 'sog'), many=True),
    Flag(option='--resolution', panel='Scans and dense maps', help='Cell size of the dense map in metres. [0.2]', metavar='M', jobs=('run', 'map'), field='extensions.dense_maps.resolution_m', kind=float),
    Flag(option='--dynamic', panel='Scans and dense maps', help='Detect moving objects and exclude them from the filter. [off]', jobs=('run', 'map'), settings={True: {}, False: None}, off=True, field='extensions.dynamic', kind=bool),
    Flag(option='--high-level', jobs=('run',), settings={True: {}, False: None}, off=True, field='extensions.high_level', kind=bool),
    Flag(option='--third', panel='Estimators', help='Third estimator: none or fastslam (particles). [none]', jobs=('run',), settings={'none': None, 'fastslam': {}}, field='extensions.fastslam', words=('none', 'fastslam')),
    Flag(option='--layer', panel='Scans and dense maps', help='Map layer (repeatable): points, occupancy, particles or sog (sum of Gaussians). [occupancy]', jobs=('map',), field='extensions.dense_maps.layers', words=('points', 'occupancy', 'particles', 'sog'), many=True),
    Flag(option='--smoother', panel='Estimators', help='Method: batch, isam2 (incremental) or fixed-lag. [batch]', jobs=('run', 'solve'), field='smoother.method', words=('batch', 'isam2', 'fixed-lag')),
    Flag(option='--lag', jobs=('run', 'solve'), where=Where(field='smoother.method', value='fixed-lag', words='--smoother fixed-lag'), field='smoother.lag', kind=int),
    Flag(option='--optimiser', jobs=('run', 'solve'), where=Where(field='smoother.method', value='batch', words='--smoother batch'), field='smoother.optimiser', words=('levenberg-marquardt', 'gauss-newton', 'dogleg')),
    Flag(option='--robust', panel='Estimators', help='Robust smoother kernel: none, huber, cauchy, gnc. [none]', jobs=('run', 'solve', 'check'), field='smoother.robust', words=('none', 'huber', 'cauchy', 'gnc')),
    Flag(option='--accept-misfit', jobs=('run', 'solve', 'check'), field='smoother.accept_misfit', kind=bool),
    Flag(option='--preset', jobs=('run', 'solve', 'check', 'map', 'odometry'), field='preset', words=('recommended', 'guivant-2002', 'misono-2007', 'nieto-2005')),
    Flag(option='--format', panel='Log, settings and report', help='Format of the log, named as in `slamcheck logs`. [recognised]', metavar='NAME', jobs=('run', 'solve', 'check', 'map', 'odometry'), field='log.format'),
    Flag(option='--robot', panel='Log, settings and report', help='Robot number in an MR.CLAM folder. [1]', metavar='N', jobs=('run', 'solve', 'check', 'map', 'odometry'), field='log.robot', kind=int),
    Flag(option='--topic', panel='Log, settings and report', help='Topic of a ROS bag to read; repeat it for several. [per message type, the only one]', metavar='NAME', jobs=('run', 'solve', 'check', 'map', 'odometry'), field='log.topics', many=True),
    Flag(option='--start', panel='Log, settings and report', help='Skip the first S seconds of the log. [0]', metavar='S', jobs=('run', 'solve', 'check', 'map', 'odometry'), field='log.start_s', kind=float),
    Flag(option='--end', panel='Log, settings and report', help="Stop S seconds after the log's start. [its end]", metavar='S', jobs=('run', 'solve', 'check', 'map', 'odometry'), field='log.end_s', kind=float),
    Flag(option='--seed', panel='Log, settings and report', help='Random seed of a simulated log. [0]', metavar='N', jobs=('run', 'solve', 'check', 'map', 'odometry'), field='log.seed', kind=int),
    Flag(option='--loops', panel='Log, settings and report', help='Number of loops of a simulated log. [1]', metavar='N', jobs=('run', 'solve', 'check', 'map', 'odometry'), field='log.loops', kind=int),
    Flag(option='--noise-scale', panel='Log, settings and report', help='Factor on the noise of a simulated log and on its stated sigmas. [1]', metavar='X', jobs=('run', 'solve', 'check', 'map', 'odometry'), field='log.noise_scale', kind=float),
    Flag(option='--prior-pose', panel='Log, settings and report', help="Start pose. [the log's]", metavar='X,Y,RAD', jobs=('run', 'solve', 'check', 'map', 'odometry'), text=True, field='log.prior_pose'),
    Flag(option='--align', panel='Log, settings and report', help="Lay truth, and an estimate without trace, onto the log's start pose: their frame is another.", jobs=('run', 'check'), field='log.align', kind=bool),
    Flag(option='--fail-on', panel='Log, settings and report', help='Exit 1 also on: consistency (filter inconsistent), truth (smoother far off), association (unchecked).', metavar='WHAT,...', jobs=('run',), text=True, field='fail_on'),
    Flag(option='--figures', jobs=('run',), field='report.figures', words=('png', 'pdf'), many=True),
    Flag(option='--trace', jobs=('run',), field='report.trace', kind=bool),
    Flag(option='--association', panel='Estimators', help='Association: known (labels) or own (found by the smoother). [known, else own]', jobs=('solve', 'check'), field='association', words=('known', 'own')),
    Flag(option='--gps', panel='Estimators', help='GPS: off, on, half (every second minute held out). [off]', jobs=('solve', 'check'), field='gps', words=('off', 'on', 'half')),
    Flag(option='--estimate', panel='Estimate', help='Trajectory (TUM, KITTI, CSV) or estimate folder (docs/formats.md).', metavar='PATH', jobs=('check',), field='estimate'),
    Flag(option='--times', panel='Estimate', help='Time stamps of a KITTI trajectory. [times.txt beside it]', metavar='FILE', jobs=('check',), field='times'),
    Flag(option='--trace', panel='Estimate', help="What the filter did, recorded. [filter.trace in the estimate's folder]", metavar='FILE', jobs=('check',), field='trace'),
    Flag(option='--require', panel='Estimate', help='Lowest grade that exits with 0: equal, like (within 5 %) or plausible. [like for an EKF, else plausible]', jobs=('check',), field='require', words=('equal', 'like', 'plausible')),
    Flag(option='--min-coverage', panel='Estimate', help="Least share of the log's duration that the estimate must cover. [0.95]", metavar='SHARE', jobs=('check',), field='min_coverage', kind=float),
    Flag(option='--cloud', panel='Log, settings and report', help='Write the map as point cloud: pcd, ply (Open3D).', jobs=('map', 'odometry'), field='cloud', words=('pcd', 'ply')),
    Flag(option='--guess', panel='Scan front end', help='Initial guess of scan matching: wheels (wheel odometry) or none. [wheels]', jobs=('odometry',), field='front_end.guess', words=('wheels', 'none')),
    Flag(option='--loop-closure', panel='Scan front end', help='Detect loop closures and add them to the pose graph. [on]', jobs=('odometry',), off=True, field='front_end.loop_closure', kind=bool),
    Flag(option='--matcher', panel='Scan front end', help='Scan matcher of loop closure: surface, kiss, point-to-point, point-to-plane or generalised. [surface]', jobs=('odometry',), where=Where(field='front_end.loop_closure', value=True, words='--loop-closure'), field='front_end.matcher', words=('surface', 'kiss', 'point-to-point', 'point-to-plane', 'generalised')),
    Flag(option='--gps', panel='Scan front end', help='GPS: off, on, half (every second minute held out). [off]', jobs=('odometry',), field='front_end.gps', words=('off', 'on', 'half')),
)


def of_job(job: str) -> tuple[Flag, ...]:
    """Return the options of a job."""
    return tuple(flag for flag in FLAGS if job in flag.jobs)
