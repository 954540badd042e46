#include "accel/sphere_geometry.h"

#include <cmath>

namespace raykiln {

double intersect_sphere(const Vec3f& origin, const Vec3f& direction, double t_near,
                        double t_far, const Vec3f& center, float radius) {
    const double dx = direction.x, dy = direction.y, dz = direction.z;
    const double ox = double(origin.x) - center.x;
    const double oy = double(origin.y) - center.y;
    const double oz = double(origin.z) - center.z;
    const double a = dx * dx + dy * dy + dz * dz;
    const double t_mid = -(ox * dx + oy * dy + oz * dz) / a;
    const double mx = ox + t_mid * dx, my = oy + t_mid * dy, mz = oz + t_mid * dz;
    const double gap = double(radius) * radius - (mx * mx + my * my + mz * mz);
    if (gap < 0) {
        return -1;
    }
    const double half = std::sqrt(gap / a);
    const double first = t_mid - half;
    if (first > t_near && first < t_far) {
        return first;
    }
    const double second = t_mid + half;
    return second > t_near && second < t_far ? second : -1;
}

namespace {

const Sphere& sphere_of(void* user) {
    return *static_cast<const Sphere*>(user);
}

void sphere_bounds(const RTCBoundsFunctionArguments* args) {
    const Sphere& s = sphere_of(args->geometryUserPtr);
    // A little wider than the sphere, as its points are rounded.
    const float r = s.radius * 1.00001f +
                    1e-6f * max(std::fabs(s.center.x),
                                max(std::fabs(s.center.y), std::fabs(s.center.z)));
    RTCBounds* b = args->bounds_o;
    b->lower_x = s.center.x - r;
    b->lower_y = s.center.y - r;
    b->lower_z = s.center.z - r;
    b->upper_x = s.center.x + r;
    b->upper_y = s.center.y + r;
    b->upper_z = s.center.z + r;
}

double intersect_lane(const Sphere& s, RTCRayN* rays, unsigned n, unsigned i) {
    const Vec3f origin{RTCRayN_org_x(rays, n, i), RTCRayN_org_y(rays, n, i),
                       RTCRayN_org_z(rays, n, i)};
    const Vec3f direction{RTCRayN_dir_x(rays, n, i), RTCRayN_dir_y(rays, n, i),
                          RTCRayN_dir_z(rays, n, i)};
    return intersect_sphere(origin, direction, RTCRayN_tnear(rays, n, i),
                            RTCRayN_tfar(rays, n, i), s.center, s.radius);
}

void sphere_intersect(const RTCIntersectFunctionNArguments* args) {
    const Sphere& s = sphere_of(args->geometryUserPtr);
    const unsigned n = args->N;
    RTCRayN* rays = RTCRayHitN_RayN(args->rayhit, n);
    RTCHitN* hits = RTCRayHitN_HitN(args->rayhit, n);
    for (unsigned i = 0; i < n; ++i) {
        if (args->valid[i] == 0) {
            continue;
        }
        const double t = intersect_lane(s, rays, n, i);
        if (t < 0) {
            continue;
        }
        const auto along = [&](float o, float d, float c) {
            return static_cast<float>(o + t * d - c);
        };
        RTCRayN_tfar(rays, n, i) = static_cast<float>(t);
        RTCHitN_Ng_x(hits, n, i) =
            along(RTCRayN_org_x(rays, n, i), RTCRayN_dir_x(rays, n, i), s.center.x);
        RTCHitN_Ng_y(hits, n, i) =
            along(RTCRayN_org_y(rays, n, i), RTCRayN_dir_y(rays, n, i), s.center.y);
        RTCHitN_Ng_z(hits, n, i) =
            along(RTCRayN_org_z(rays, n, i), RTCRayN_dir_z(rays, n, i), s.center.z);
        RTCHitN_u(hits, n, i) = 0.0f;
        RTCHitN_v(hits, n, i) = 0.0f;
        RTCHitN_primID(hits, n, i) = args->primID;
        RTCHitN_geomID(hits, n, i) = args->geomID;
        RTCHitN_instID(hits, n, i, 0) = args->context->instID[0];
    }
}

void sphere_occluded(const RTCOccludedFunctionNArguments* args) {
    const Sphere& s = sphere_of(args->geometryUserPtr);
    for (unsigned i = 0; i < args->N; ++i) {
        if (args->valid[i] != 0 && intersect_lane(s, args->ray, args->N, i) >= 0) {
            RTCRayN_tfar(args->ray, args->N, i) = -infinity;
        }
    }
}

}  // namespace

RTCGeometry make_sphere_geometry(RTCDevice device, const Sphere* sphere) {
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_USER);
    rtcSetGeometryUserPrimitiveCount(geometry, 1);
    rtcSetGeometryUserData(geometry, const_cast<Sphere*>(sphere));
    rtcSetGeometryBoundsFunction(geometry, sphere_bounds, nullptr);
    rtcSetGeometryIntersectFunction(geometry, sphere_intersect);
    rtcSetGeometryOccludedFunction(geometry, sphere_occluded);
    return geometry;
}

}  // namespace raykiln
