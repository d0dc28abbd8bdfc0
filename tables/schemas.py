"""Every table of the benchmark: what its rows are, its key, and each column's type, unit and meaning."""

from __future__ import annotations

from tables.columns import TableSchema, enum, flag, integer, integers, joints, plain, pose, real, reals, single, text
from tables.vocabulary import (
    AdmissionStatus,
    Audit,
    Category,
    ExecStatus,
    LiftStatus,
    Perturbation,
    PlanStatus,
    PointType,
    Split,
    SplitScheme,
    Symmetry,
)

# A change of any table makes a new version, which that table then names as its `since`.
SCHEMA_VERSION = "2.4.0"

_SCENE_ID = text("scene_id", "scene, also the scene group")
_OBJECT_ID = text("object_id", "catalogue object")
_CATEGORY = enum("category", Category, "kind of object")
_N_OBSTACLES = integer("n_obstacles", "box obstacles in the scene: 0, 1 or 2")
_TARGET_ID = integer("target_id", "target of the scene, 0 to 7")
_GRASP_ID = integer("grasp_id", "grasp of the object's pool, fixed for ever")
_CANDIDATE_ID = plain("candidate_id", "<scene_id>-t<target_id>-g<grasp_id>")
_STABLE_POSE_ID = integer("stable_pose_id", "stable pose of the object")

OBJECTS = TableSchema("objects", "one row per catalogue object", ("object_id",), (
    _OBJECT_ID, _CATEGORY,
    text("name", "product the dimensions are taken from"), text("source", "where dimensions and mass come from"),
    real("size_x_m", "extent of the mesh along object x", "m"), real("size_y_m", "extent along object y", "m"), real("size_z_m", "extent along object z", "m"),
    real("mass_kg", "mass", "kg"), real("friction", "lateral friction coefficient (multiplied pairwise by the engine)"),
    real("com_x_m", "centre of mass in the object frame (x)", "m"), real("com_y_m", "centre of mass in the object frame (y)", "m"), real("com_z_m", "centre of mass in the object frame (z)", "m"),
    real("ixx_kg_m2", "inertia about the centre of mass, object axes", "kg m2"), real("iyy_kg_m2", "inertia", "kg m2"), real("izz_kg_m2", "inertia", "kg m2"),
    real("ixy_kg_m2", "product of inertia", "kg m2"), real("ixz_kg_m2", "product of inertia", "kg m2"), real("iyz_kg_m2", "product of inertia", "kg m2"),
    enum("symmetry", Symmetry, "rotational symmetry used by stable poses and validation"),
    real("mesh_volume_m3", "volume of the watertight mesh", "m3"), real("hull_volume_ratio", "total volume of the convex parts over the mesh volume"),
    real("cavity_fill", "share of a mug's cavity that the convex parts fill", nullable=True), real("handle_hole_fill", "share of a mug's handle hole that the convex parts fill", nullable=True),
    real("min_graspable_width_m", "smallest width between parallel jaws over all pool grasps", "m"),
    plain("mesh_sha256", "hash of vertices and faces"), plain("parts_sha256", "hash of the convex parts"),
))

OBJECT_MESHES = TableSchema("object_meshes", "the watertight triangle mesh of each object, object frame", ("object_id",), (
    _OBJECT_ID, reals("vertices_m", "x, y, z of each vertex, flat", "m"), integers("faces", "three vertex numbers a face, flat"),
))

OBJECT_PARTS = TableSchema("object_parts", "the convex parts of each object, object frame", ("object_id", "part_id"), (
    _OBJECT_ID, integer("part_id", "part of the object"), reals("vertices_m", "x, y, z of each hull vertex, flat", "m"), integers("faces", "three vertex numbers a face, flat"),
))

STABLE_POSES = TableSchema("stable_poses", "resting poses of each object on a horizontal plane, merged by symmetry", ("object_id", "stable_pose_id"), (
    _OBJECT_ID, _STABLE_POSE_ID, text("resting", "name of the pose: upright, inverted, lying, on_handle, face_x, ..."),
    real("probability", "share of random drops that come to rest in this pose"),
    *pose("rest", "T_plane_object: object frame in the plane's frame, x = y = 0"),
))

GRASP_POOL = TableSchema("grasp_pool", "antipodal grasps of each object, object frame", ("object_id", "grasp_id"), (
    _OBJECT_ID, _GRASP_ID, text("grasp_kind", "where the fingers close: side, top, rim, handle, body, face_x, ..."),
    *pose("objectgrasp", "T_object_grasp: TCP frame in the object frame"),
    real("jaw_width_m", "distance between the two contacts", "m"),
    real("cone_margin_rad", "friction-cone half angle minus the larger contact angle", "rad"),
    real("com_distance_m", "distance of the centre of mass from the line between the contacts", "m"),
))

SCENES = TableSchema("scenes", "one object at its initial pose, its obstacle count", ("scene_id",), (
    _SCENE_ID, integer("scene_index", "number of the scene in its family"), _OBJECT_ID, _CATEGORY, _N_OBSTACLES, _STABLE_POSE_ID,
    *pose("object", "T_base_object: settled initial object pose"), integer("n_attempts", "draws of the whole scene until one was valid"),
))

SCENE_ATTEMPTS = TableSchema("scene_attempts", "every draw of scene sampling that was rejected, and why", ("scene_id", "attempt", "item", "draw"), (
    _SCENE_ID, integer("attempt", "scene draw"), text("item", "object, obstacle-<k> or target-<k>"), integer("draw", "draw of this item"), text("reason", "why it was redrawn"),
))

OBSTACLES = TableSchema("obstacles", "box obstacles", ("scene_id", "obstacle_id"), (
    _SCENE_ID, integer("obstacle_id", "obstacle of the scene"), *pose("obstacle", "T_base_obstacle: box centre"),
    real("size_x_m", "box edge along its x", "m"), real("size_y_m", "box edge along its y", "m"), real("size_z_m", "box edge along its z", "m"),
))

TARGETS = TableSchema("targets", "requested object poses", ("scene_id", "target_id"), (
    _SCENE_ID, _TARGET_ID, _STABLE_POSE_ID, text("resting", "name of the stable pose"), *pose("target", "T_base_target: requested object pose"),
    real("rest_drift_m", "how far the object moved when left there alone", "m"), real("rest_drift_rad", "how far it turned, modulo symmetry", "rad"),
))

SCENE_POINTS = TableSchema("scene_points", "typed point cloud of the initial scene from two depth views, base frame, on a grid of 1/8192 m", ("scene_id", "point"), (
    _SCENE_ID, integer("point", "number of the point"), enum("point_type", PointType, "what the point lies on"),
    single("x_m", "base frame", "m"), single("y_m", "base frame", "m"), single("z_m", "base frame", "m"),
))

_ADMISSION = (
    enum("admission_status", AdmissionStatus, "outcome of geometric admission"),
    *pose("grasp", "T_base_grasp: TCP at the grasp"),
    *joints("pregrasp_q", "arm at the pregrasp pose", nullable=True), *joints("grasp_q", "arm at the grasp", nullable=True),
    integer("n_ik", "collision-free inverse-kinematics solutions at the grasp that were tried", nullable=True),
)
_LIFT = (
    enum("lift_status", LiftStatus, "outcome of the physics pick-lift check", nullable=True),
    real("lift_slip_m", "motion of the object in the hand from closing to the end of the hold", "m", nullable=True),
    real("lift_slip_rad", "turn of the object in the hand from closing to the end of the hold", "rad", nullable=True),
    *joints("lifted_q", "arm after the hold, measured", nullable=True),
    real("lifted_finger_left_m", "left finger joint after the hold", "m", nullable=True), real("lifted_finger_right_m", "right finger joint after the hold", "m", nullable=True),
    *pose("lifted", "T_base_object after the hold, measured", nullable=True),
    *pose("inhand", "T_tcp_object after the hold, measured; supervision only", nullable=True),
)

GRASP_ADMISSION = TableSchema("grasp_admission", "every pool grasp in every scene and why it was or was not admitted", ("scene_id", "grasp_id"), (_SCENE_ID, _GRASP_ID, *_ADMISSION))

PICK_LIFT = TableSchema("pick_lift", "every admitted grasp and what physics said", ("scene_id", "grasp_id"), (_SCENE_ID, _GRASP_ID, *_LIFT))

GRASPS = TableSchema("grasps", "admission and pick-lift outcome of every pool grasp in every scene", ("scene_id", "grasp_id"), (
    _SCENE_ID, _GRASP_ID, _OBJECT_ID, text("grasp_kind", "where the fingers close"), *_ADMISSION, *_LIFT,
))

CANDIDATE_PAIRS = TableSchema("candidate_pairs", "every lifted grasp with every target", ("scene_id", "target_id", "grasp_id"), (
    _CANDIDATE_ID, _SCENE_ID, _TARGET_ID, _GRASP_ID, _OBJECT_ID, _CATEGORY, _N_OBSTACLES,
))

_PLANNING = (
    flag("y_plan", "a complete placement motion was found"), enum("plan_status", PlanStatus, "outcome of planning"),
    real("min_clearance_m", "smallest distance of arm, hand or object to table or obstacles along the transport path", "m", nullable=True),
    integer("n_goals", "collision-free goal configurations kept"), integer("n_checks", "configurations checked for collision"),
    real("plan_duration_s", "timed duration of transport, descend and retreat", "s", nullable=True),
    real("path_length_rad", "joint-space length of the transport path", "rad", nullable=True),
    integer("n_waypoints", "waypoints of the transport path", nullable=True),
    flag("used_search", "RRTConnect was needed because direct interpolation was blocked"),
)

PLANNING_LABELS = TableSchema("planning_labels", "planning outcome of every candidate", ("candidate_id",), (_CANDIDATE_ID, *_PLANNING))

PLANS = TableSchema("plans", "what is needed to rebuild the motion of a solved candidate exactly", ("candidate_id",), (
    _CANDIDATE_ID, *joints("place_q", "arm where the hand lets go; descend and retreat are the straight lines through it at this joint 7"),
    reals("via_q_rad", "waypoints of the transport between post-lift and pre-place, 7 values each, flat; mostly none: it is straight in joint space", "rad"),
))

POLICY_FEATURES = TableSchema("policy_features", "what the endpoint baselines know about a candidate", ("candidate_id",), (
    _CANDIDATE_ID, flag("ik_feasible", "the place pose has an inverse-kinematics solution, collisions ignored"),
    flag("gripper_free", "hand and fingers at the place pose are free of table and obstacles"),
))

_EXECUTION = (
    flag("y_pipe", "the executed plan ended in a valid final pose without a slip in the hand; null where no plan exists", nullable=True),
    enum("exec_status", ExecStatus, "outcome of execution; null where no plan exists", nullable=True),
    real("final_position_error_m", "distance of the final object pose from the target", "m", nullable=True),
    real("final_rotation_error_rad", "turn of the final object pose from the target, modulo symmetry", "rad", nullable=True),
    real("tolerance_margin", "1 minus the larger of the two errors over its tolerance; negative is off target", nullable=True),
    real("transport_slip_m", "largest motion of the object in the hand before release", "m", nullable=True),
    real("transport_slip_rad", "largest turn of the object in the hand before release", "rad", nullable=True),
    real("release_position_error_m", "distance from the target when the fingers start to open", "m", nullable=True),
    real("release_rotation_error_rad", "turn from the target when the fingers start to open, modulo symmetry", "rad", nullable=True),
    real("retreat_drag_m", "object motion between the fingers' opening and the end of the retreat", "m", nullable=True),
    integer("n_physics_steps", "ticks of 1/240 s simulated; contacts are solved several times in each", nullable=True),
    *pose("final", "T_base_object at the end, measured", nullable=True),
)

EXECUTION_LABELS = TableSchema("execution_labels", "execution outcome of every planned candidate", ("candidate_id",), (_CANDIDATE_ID, *_EXECUTION))

CANDIDATES = TableSchema("candidates", "the benchmark: every candidate with both labels", ("scene_id", "target_id", "grasp_id"), (*CANDIDATE_PAIRS.columns, *_PLANNING, *_EXECUTION))

_SPLIT_MEANINGS = {
    SplitScheme.SCENE: "train, validation or test",
    SplitScheme.OBJECT: "train, validation or test by object: test has 6 objects that no other split has, one of each size class; validation 6 others",
    SplitScheme.CATEGORY_CAN: "train, validation or test by category: test has all scenes with a can, validation and train have none",
    SplitScheme.CATEGORY_MUG: "train, validation or test by category: test has all scenes with a mug, validation and train have none",
    SplitScheme.CATEGORY_CUBOID: "train, validation or test by category: test has all scenes with a cuboid, validation and train have none",
    SplitScheme.LAYOUT: "train, validation or test by layout: test has all scenes with 2 obstacles, validation and train have 0 or 1",
}

SPLITS = TableSchema("splits", "who may see which scene group, a column a split scheme", ("scene_id",), (
    _SCENE_ID, *(enum(scheme.column, Split, meaning) for scheme, meaning in _SPLIT_MEANINGS.items()),
), since="2.1.0")

ATTEMPTS = TableSchema("attempts", "repeat executions of candidates, under a perturbation or in a fresh process", ("candidate_id", "perturbation", "repeat"), (
    _CANDIDATE_ID, enum("perturbation", Perturbation, "what was changed"), integer("repeat", "number of the repeat"),
    enum("plan_status", PlanStatus, "outcome of planning in the repeat"), enum("exec_status", ExecStatus, "outcome of execution in the repeat", nullable=True),
    real("final_position_error_m", "position error in the repeat", "m", nullable=True), real("final_rotation_error_rad", "rotation error in the repeat", "rad", nullable=True),
    flag("plan_matches", "planning outcome equals the stored one"), flag("exec_matches", "execution status equals the stored one, or both are null"),
    flag("is_identical", "every stored label column is bit-identical"),
))

AUDITS = TableSchema("audits", "planning labels checked again by an independent or finer judge", ("candidate_id", "audit"), (
    _CANDIDATE_ID, enum("audit", Audit, "how the label was checked"),
    enum("stored_status", PlanStatus, "outcome of planning as stored"),
    enum("audited_status", PlanStatus, "outcome as the audit judges it; null where a path is measured instead", nullable=True),
    real("depth_m", "deepest overlap of two bodies on a solved path; negative where none touch: how near two come, at most 5 mm", "m", nullable=True),
    text("deepest_pair", "phase and bodies of that overlap", nullable=True),
    real("clearance_m", "smallest distance of arm, hand or held object to table or obstacles on a solved path, at most 5 mm", "m", nullable=True),
    integer("n_configurations", "configurations checked for collision"),
    flag("agrees", "the label holds: no overlap deeper than 1 mm, or the same answer to whether a plan exists"),
))

PREDICTIONS = TableSchema("predictions", "what a trained ranker says of every candidate", ("variant", "seed", "candidate_id"), (
    text("variant", "full, direct, no_object_relative or no_target_hypothesis; trees or trees_poses of the probe"), integer("seed", "training seed"), _CANDIDATE_ID,
    single("log_p_plan", "log probability that a plan exists, with 15 bits of mantissa"),
    single("log_p_exec", "log probability of success given a plan, with 15 bits of mantissa; the ranking score is the sum of both, in 32 bits"),
), since="2.2.0")

TEST_REPLICATES = TableSchema("test_replicates", "planned candidates of the test split executed again under small real uncertainty", ("candidate_id", "replicate"), (
    _CANDIDATE_ID, integer("replicate", "number of the replicate; what is drawn follows from it and the id"),
    real("friction_scale", "of every pair with the object"), real("mass_scale", "of the object's mass and inertia"),
    real("shift_x_m", "of the object in the hand, along x of the TCP", "m"), real("shift_y_m", "along y, in which the jaws close", "m"), real("shift_z_m", "along z", "m"),
    real("turn_x_rad", "of the object in the hand about its origin: rotation vector in the axes of the TCP (x)", "rad"), real("turn_y_rad", "about y", "rad"), real("turn_z_rad", "about z", "rad"),
    integer("late_transport_ticks", "ticks of 1/240 s by which the transport starts late; negative is early"), integer("late_descend_ticks", "of the descend"), integer("late_retreat_ticks", "of the retreat"),
    enum("exec_status", ExecStatus, "outcome of the execution"), flag("is_success", "the outcome is success"),
    real("tolerance_margin", "1 minus the larger of the two errors over its tolerance; negative is off target"),
), since="2.3.0")

PLANNER_COSTS = TableSchema("planner_costs", "what planning a candidate took, when it was labelled or once more: the planning stage of `timings`, small enough to ship", ("candidate_id",), (
    _CANDIDATE_ID, single("core_ms", "CPU time of the planner", "ms"),
), since="2.4.0")

LEARNING_CURVE = TableSchema("learning_curve", "what rankers that were trained on some of the train split say of the candidates of the validation split", ("variant", "n_train_scenes", "seed", "candidate_id"), (
    text("variant", "as in predictions"), integer("n_train_scenes", "scenes of the train split that it was trained on"), integer("seed", "training seed"), _CANDIDATE_ID,
    single("log_p_plan", "as in predictions"), single("log_p_exec", "as in predictions"),
), since="2.4.0")

TIMINGS = TableSchema("timings", "core time of each unit of work, measured once; never part of a hashed release", ("stage", "item_id"), (
    text("stage", "stage that spent the time"), plain("item_id", "scene, grasp or candidate"), real("core_ms", "CPU time of the worker", "ms"),
))

# The tables that describe the objects, in the order that objects.object_model takes them.
OBJECT_TABLES = ("objects", "object_meshes", "object_parts", "stable_poses", "grasp_pool")

# Tables that a light release leaves out, and what `python -m splits.rebuild DIR` is told to make each again; None where nothing can.
HEAVY_TABLES: dict[str, str | None] = {"plans": "plans", "scene_points": "points", "scene_attempts": "rejections", "timings": None}

LABEL_COLUMNS = tuple(column.name for column in (*_PLANNING, *_EXECUTION))

ALL_SCHEMAS = {schema.name: schema for schema in (
    OBJECTS, OBJECT_MESHES, OBJECT_PARTS, STABLE_POSES, GRASP_POOL, SCENES, SCENE_ATTEMPTS, OBSTACLES, TARGETS, SCENE_POINTS, GRASP_ADMISSION, PICK_LIFT, GRASPS,
    CANDIDATE_PAIRS, PLANNING_LABELS, PLANS, POLICY_FEATURES, EXECUTION_LABELS, CANDIDATES, SPLITS, ATTEMPTS, AUDITS, PREDICTIONS, TEST_REPLICATES, PLANNER_COSTS, LEARNING_CURVE, TIMINGS,
)}  # fmt: skip
