"""Rigid transforms, cameras, planes, boxes, grids, depth and meshes: functions and values without state."""

from kinectbench.core.geometry.boxes import BoxAnchor, Grid, OrientedBox, Pose, yaw_rotation
from kinectbench.core.geometry.camera import Camera, DepthRenderer, image_normals
from kinectbench.core.geometry.depth import (
    MOST_MM,
    NO_CALIBRATION,
    SIGMA_GROWTH_PER_M,
    SIGMA_NEAR_DEPTH_M,
    SIGMA_NEAR_M,
    TERMS,
    TOO_FAR,
    DepthCalibration,
    corrected_depth_m,
    depth_in_mm,
    depth_sigma_m,
    legendre_terms,
    too_far_for_mm,
)
from kinectbench.core.geometry.mesh import (
    Tensors,
    TriangleMesh,
    box_mesh,
    decimated,
    is_closed,
    isosurface,
    join,
    joined_vertices,
    outwards,
    parse_ply,
    poisson_surface,
    raycaster,
    read_own_ply,
    surface_distances_m,
    three_corners,
    why_open,
    write_ply,
)
from kinectbench.core.geometry.plane_fit import ransac_plane, refine
from kinectbench.core.geometry.rigid import (
    ORTHONORMAL_TOLERANCE,
    closest_rotation,
    interpolate_rigid,
    invert_rigid,
    invert_similarity,
    is_rigid,
    on_so3,
    quaternion_xyzw_from_rotation,
    rigid,
    rigid_from_twist,
    rotation_angle_rad,
    rotation_from_quaternion_xyzw,
    similarity_problem,
    similarity_scale,
    transform_points,
    twist_from_rigid,
)
