#pragma once

#include "accel/embree_api.h"
#include "scene/shape.h"

namespace raykiln {

/// Nearest distance along a ray to a sphere within (t_near, t_far), or a negative number.
/// Solved in double precision about the point of the ray nearest to the centre.
double intersect_sphere(const Vec3f& origin, const Vec3f& direction, double t_near,
                        double t_far, const Vec3f& center, float radius);

/// An Embree user geometry for spheres[0 .. count); they must outlive it.
RTCGeometry make_sphere_geometry(RTCDevice device, const Sphere* sphere);

}  // namespace raykiln
