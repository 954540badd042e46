#pragma once

#include "integrator/geometry.h"
#include "integrator/surface.h"
#include "light/sample_light.h"
#include "wide/planes.h"

// What the shapes that some paths met say of the places where they met them.

namespace raykiln {
inline namespace RAYKILN_WIDE_NAMESPACE {

/// The surfaces that some paths met: what their shapes and places say, lane by lane. Kept
/// from vertex to vertex, as clearing it takes long: what the masks leave out is stale.
struct MetShapes {
    TriangleCorners<F> corners;
    SphereLightOf<F> sphere;  // center and radius
    TransformOf<F> world_from_group;
    F sign;
    U emission, light;
    M on_sphere, placed, emits;
};

/// Lanes are filled one by one in memory and read back whole.
struct LaneBuffer {
    alignas(64) float at[lanes];
    F all() const { return load(at); }
};
struct LaneBuffer3 {
    LaneBuffer x, y, z;
    void set(int lane, float a, float b, float c) {
        x.at[lane] = a;
        y.at[lane] = b;
        z.at[lane] = c;
    }
    void set(int lane, const Vec3f& v) { set(lane, v.x, v.y, v.z); }
    Vec3<F> all() const { return {x.all(), y.all(), z.all()}; }
};

/// Rows of three words, a lane each; `rows` of them in all, at least two.
inline std::array<F, 3> gather_triple(const float* array, std::uint32_t rows, U row) {
    return gather3<F>(array, 3 * rows, row * U(3u));
}
inline Vec3<F> gather_point(const float* array, std::uint32_t rows, U row) {
    const std::array<F, 3> x = gather_triple(array, rows, row);
    return {x[0], x[1], x[2]};
}

/// The triangles that all lanes met on one mesh.
inline void fetch_triangles(const ShapeRecord& mesh, U primitive,
                            TriangleCorners<F>& corners) {
    const std::array<F, 3> corner = gather_triple(
        reinterpret_cast<const float*>(mesh.indices), mesh.triangle_count, primitive);
    corners.has_normals = M(mesh.normals != nullptr);
    corners.has_uv = M(mesh.uvs != nullptr);
    for (std::size_t k = 0; k < 3; ++k) {
        const U vertex = as_uint(corner[k]);
        corners.p[k] = gather_point(mesh.positions, mesh.vertex_count, vertex);
        if (mesh.normals != nullptr) {
            corners.n[k] = gather_point(mesh.normals, mesh.vertex_count, vertex);
        }
        if (mesh.uvs != nullptr) {
            const U at = vertex * U(2u);
            corners.uv[k] = {gather(mesh.uvs, at), gather(mesh.uvs + 1, at)};
        }
    }
}

inline std::uint32_t light_of_slot(const BatchScene& b, const Paths& paths,
                                   std::uint32_t slot) {
    Hit hit;
    hit.geometry = paths.geometry.at[slot];
    hit.primitive = paths.primitive.at[slot];
    hit.instance = paths.instance.at[slot];
    return light_of(b.scene, hit);
}

/// All lanes met one mesh, which is not placed anywhere.
inline void fetch_mesh(const BatchScene& b, const Paths& paths, U slots,
                       const ShapeRecord& mesh, MetShapes& met) {
    met.sign = F(mesh.sign);
    met.on_sphere = met.placed = M(false);
    met.emits = M(mesh.emission != no_index);
    if (mesh.emission != no_index) {
        alignas(64) std::uint32_t slot[lanes], light[lanes];
        store(slot, slots);
        for (int i = 0; i < lanes; ++i) {
            light[i] = light_of_slot(b, paths, slot[i]);
        }
        met.emission = U(mesh.emission);
        met.light = load(light);
    }
    fetch_triangles(mesh, paths.primitive[slots], met.corners);
}

/// Each lane's own shape, one lane after the other.
inline void fetch_each(const BatchScene& b, const Paths& paths, U slots, MetShapes& met) {
    LaneBuffer3 p[3], n[3], center, mx, my, mz, mo;
    LaneBuffer u[3], v[3], radius, sign;
    alignas(64) std::uint32_t slot[lanes], emission[lanes], light[lanes];
    std::uint32_t on_sphere = 0, placed = 0, emits = 0, has_normals = 0, has_uv = 0;
    store(slot, slots);
    for (int i = 0; i < lanes; ++i) {
        const std::uint32_t s = slot[i];
        const std::uint32_t instance = paths.instance.at[s];
        const ShapeRecord& shape = b.shapes.shapes[paths.shape.at[s]];
        const std::uint32_t bit = 1u << i;
        sign.at[i] = shape.sign;
        emission[i] = light[i] = 0;
        if (shape.emission != no_index) {
            emits |= bit;
            emission[i] = shape.emission;
            light[i] = light_of_slot(b, paths, s);
        }
        if (instance != no_index) {
            placed |= bit;
            const Transform& m = b.scene.instances[instance].world_from_group;
            mx.set(i, m.x);
            my.set(i, m.y);
            mz.set(i, m.z);
            mo.set(i, m.origin);
        }
        if (shape.sphere != nullptr) {
            on_sphere |= bit;
            center.set(i, shape.sphere->center);
            radius.at[i] = shape.sphere->radius;
            continue;
        }
        const std::uint32_t* corner =
            shape.indices + 3 * static_cast<std::size_t>(paths.primitive.at[s]);
        for (int k = 0; k < 3; ++k) {
            const float* at = shape.positions + 3 * static_cast<std::size_t>(corner[k]);
            p[k].set(i, at[0], at[1], at[2]);
        }
        if (shape.normals != nullptr) {
            has_normals |= bit;
            for (int k = 0; k < 3; ++k) {
                const float* at = shape.normals + 3 * static_cast<std::size_t>(corner[k]);
                n[k].set(i, at[0], at[1], at[2]);
            }
        }
        if (shape.uvs != nullptr) {
            has_uv |= bit;
            for (int k = 0; k < 3; ++k) {
                const float* at = shape.uvs + 2 * static_cast<std::size_t>(corner[k]);
                u[k].at[i] = at[0];
                v[k].at[i] = at[1];
            }
        }
    }
    for (int k = 0; k < 3; ++k) {
        met.corners.p[k] = p[k].all();
        if (has_normals != 0) {
            met.corners.n[k] = n[k].all();
        }
        if (has_uv != 0) {
            met.corners.uv[k] = {u[k].all(), v[k].all()};
        }
    }
    met.corners.has_normals = M::of_bits(has_normals);
    met.corners.has_uv = M::of_bits(has_uv);
    met.sign = sign.all();
    met.emission = load(emission);
    met.light = load(light);
    met.on_sphere = M::of_bits(on_sphere);
    met.placed = M::of_bits(placed);
    met.emits = M::of_bits(emits);
    if (on_sphere != 0) {
        met.sphere.center = center.all();
        met.sphere.radius = radius.all();
    }
    if (placed != 0) {
        met.world_from_group = {mx.all(), my.all(), mz.all(), mo.all()};
    }
}

inline void fetch_shapes(const BatchScene& b, const Paths& paths, U slots,
                         MetShapes& met) {
    const U shape = paths.shape[slots];
    const ShapeRecord& first = b.shapes.shapes[first_lane(shape)];
    if (first.by_gather && b.scene.instances.empty() &&
        all(shape == U(first_lane(shape)))) {
        fetch_mesh(b, paths, slots, first, met);
    } else {
        fetch_each(b, paths, slots, met);
    }
}

}  // namespace RAYKILN_WIDE_NAMESPACE
}  // namespace raykiln
