#include "accel/accel.h"

#include <gtest/gtest.h>

#include <optional>

#include "accel/sphere_geometry.h"
#include "shapes.h"

// The ray tracer against brute force in double precision.

namespace raykiln {
namespace {

using test::Rng;

struct Vec3d {
    double x, y, z;
};
Vec3d exact(const Vec3f& v) {
    return {v.x, v.y, v.z};
}
Vec3d operator-(const Vec3d& a, const Vec3d& b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}
double dot(const Vec3d& a, const Vec3d& b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
Vec3d cross(const Vec3d& a, const Vec3d& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
double norm(const Vec3d& a) {
    return std::sqrt(dot(a, a));
}

constexpr double epsilon = 0x1p-24;

/// Where a ray meets a shape, and how uncertain single precision leaves that.
struct Meeting {
    double t;
    double t_error;  ///< of t
    double margin;   ///< signed distance from the outline in units of its uncertainty
};

/// Möller and Trumbore 1997 in double precision.
std::optional<Meeting> meet_triangle(const Vec3d& o, const Vec3d& d, const Vec3d& p0,
                                     const Vec3d& p1, const Vec3d& p2) {
    const Vec3d e1 = p1 - p0, e2 = p2 - p0, q = cross(d, e2);
    const double determinant = dot(e1, q);
    if (determinant == 0) {
        return {};
    }
    const Vec3d s = o - p0, r = cross(s, e1);
    const double u = dot(s, q) / determinant, v = dot(d, r) / determinant;
    // In single precision, products of coordinates relative to the origin (size m) and
    // edges (size e) are rounded some ten times, and divided by the determinant.
    const double m = std::max({norm(s), norm(p1 - o), norm(p2 - o)});
    const double e = std::max(norm(e1), norm(e2));
    const double size = norm(d) / std::fabs(determinant) * 16 * epsilon;
    return Meeting{dot(e2, r) / determinant, m * e * e * size / norm(d),
                   std::min({u, v, 1 - u - v}) / (m * m * size + 16 * epsilon)};
}

/// The nearer root beyond 0, straight from the quadratic formula.
std::optional<Meeting> meet_sphere(const Vec3d& o, const Vec3d& d, const Vec3d& center,
                                   double radius) {
    const Vec3d s = o - center;
    const double a = dot(d, d), b = dot(s, d), c = dot(s, s) - radius * radius;
    const double discriminant = b * b - a * c;
    if (discriminant < 0) {
        return {};
    }
    const double root = std::sqrt(discriminant);
    const double near = (-b - root) / a, far = (-b + root) / a;
    const double t = near > 0 ? near : far;
    // t is rounded once. The outline is where the discriminant is 0.
    return Meeting{t, 4 * epsilon * std::fabs(t) + 1e-12,
                   std::min(discriminant / (b * b + 1e-30) / (16 * epsilon),
                            std::fabs(near) / 1e-9)};
}

/// A shape of the scene under the transforms above it, and its name in a hit.
struct Flat {
    Vec3d p[3];
    std::uint32_t geometry, primitive, instance;
    const Sphere* sphere = nullptr;
};

struct BruteForce {
    std::vector<Flat> shapes;
    const Scene& scene;

    explicit BruteForce(const Scene& s) : scene(s) {
        add(s.groups[0], no_index);
        for (std::uint32_t i = 0; i < s.instances.size(); ++i) {
            add(s.groups[s.instances[i].group], i);
        }
    }

    Vec3d placed(const Vec3f& p, std::uint32_t instance) const {
        if (instance == no_index) {
            return exact(p);
        }
        const Transform& m = scene.instances[instance].world_from_group;
        const auto row = [&](float x, float y, float z, float o) {
            return double(x) * p.x + double(y) * p.y + double(z) * p.z + o;
        };
        return {row(m.x.x, m.y.x, m.z.x, m.origin.x),
                row(m.x.y, m.y.y, m.z.y, m.origin.y),
                row(m.x.z, m.y.z, m.z.z, m.origin.z)};
    }

    void add(const Group& group, std::uint32_t instance) {
        std::uint32_t geometry = 0;
        for (const Mesh& mesh : group.meshes) {
            for (std::uint32_t t = 0; t < mesh.triangle_count; ++t) {
                const std::uint32_t* v = mesh.indices + 3 * t;
                shapes.push_back({{placed(mesh.position(v[0]), instance),
                                   placed(mesh.position(v[1]), instance),
                                   placed(mesh.position(v[2]), instance)},
                                  geometry,
                                  t,
                                  instance});
            }
            ++geometry;
        }
        for (const Sphere& sphere : group.spheres) {
            shapes.push_back({{}, geometry++, 0, instance, &sphere});
        }
    }

    /// The ray in a sphere's own space, where t is the same.
    std::optional<Meeting> meet(const Flat& f, const Ray& ray) const {
        Vec3d o = exact(ray.origin), d = exact(ray.direction);
        if (f.sphere == nullptr) {
            return meet_triangle(o, d, f.p[0], f.p[1], f.p[2]);
        }
        if (f.instance != no_index) {
            const Instance& instance = scene.instances[f.instance];
            o = into_group(o - exact(instance.world_from_group.origin), instance);
            d = into_group(d, instance);
        }
        auto meeting = meet_sphere(o, d, exact(f.sphere->center), f.sphere->radius);
        if (meeting && f.instance != no_index) {
            // The ray is rounded on its way into the group.
            const double shift = 16 * epsilon * (norm(o) + 10);
            const double steepness = std::sqrt(std::max(1e-12, grazing(o, d, *f.sphere)));
            meeting->t_error += shift / norm(d) / steepness;
            meeting->margin *= 0.01;
        }
        return meeting;
    }

    static double grazing(const Vec3d& o, const Vec3d& d, const Sphere& sphere) {
        const Vec3d s = o - exact(sphere.center);
        const Vec3d across = cross(s, d);
        const double nearest = norm(across) / norm(d) / sphere.radius;
        return 1 - nearest * nearest;
    }

    static Vec3d into_group(const Vec3d& v, const Instance& instance) {
        const Transform& m = instance.world_from_group;
        // Cramer's rule in double precision.
        const Vec3d a = exact(m.x), b = exact(m.y), c = exact(m.z);
        const double det = dot(a, cross(b, c));
        return {dot(v, cross(b, c)) / det, dot(a, cross(v, c)) / det,
                dot(a, cross(b, v)) / det};
    }

    struct Nearest {
        const Flat* shape = nullptr;
        Meeting at{1e30, 0, 0};
    };
    Nearest nearest(const Ray& ray) const {
        Nearest best;
        for (const Flat& f : shapes) {
            const auto meeting = meet(f, ray);
            if (meeting && meeting->margin >= 0 && meeting->t > 0 &&
                meeting->t < best.at.t) {
                best = {&f, *meeting};
            }
        }
        return best;
    }
    const Flat* find(const Hit& hit) const {
        for (const Flat& f : shapes) {
            if (f.geometry == hit.geometry && f.primitive == hit.primitive &&
                f.instance == hit.instance) {
                return &f;
            }
        }
        return nullptr;
    }
};

/// Triangles, spheres and instances of both, in a cube of some units.
Scene random_scene(std::uint64_t seed) {
    Rng rng(seed);
    Scene scene;
    scene.groups.resize(2);
    const auto random_sphere = [&] {
        Sphere s;
        s.center = {rng.between(-1, 1), rng.between(-1, 1), rng.between(-1, 1)};
        s.radius = rng.between(0.02f, 0.3f);
        return s;
    };
    for (int i = 0; i < 2; ++i) {
        Group& group = scene.groups[static_cast<std::size_t>(i)];
        group.meshes.push_back(test::make_mesh(test::make_soup(25, 0.4f, rng)));
        group.meshes.push_back(
            test::make_mesh(test::make_ball(0, {0.3f, 0.2f, -0.4f}, 0.3f, 0.2f, rng)));
        group.spheres = {random_sphere(), random_sphere(), random_sphere()};
    }
    for (int i = 0; i < 2; ++i) {
        const Vec3f scale(rng.between(0.3f, 2), rng.between(0.3f, 2),
                          rng.between(-2, -0.3f));
        const Vec3f origin(rng.between(-2, 2), rng.between(-2, 2), rng.between(-2, 2));
        scene.instances.push_back(
            test::make_instance(1, test::random_placement(scale, origin, rng)));
    }
    return scene;
}

Ray random_ray(Rng& rng) {
    const Vec3f origin(rng.between(-3, 3), rng.between(-3, 3), rng.between(-3, 3));
    const Vec3f target(rng.between(-1, 1), rng.between(-1, 1), rng.between(-1, 1));
    // Lengths other than 1 are allowed: shadow rays are segments.
    return {origin, (target - origin) * rng.between(0.2f, 3.0f)};
}

TEST(Accel, AgreesWithBruteForceOnAMillionRays) {
    constexpr int scenes = 5, rays = 200000;
    int hits = 0, doubtful = 0;
    for (int s = 0; s < scenes; ++s) {
        const Scene scene = random_scene(81 + static_cast<std::uint64_t>(s));
        const Accel accel(scene);
        const BruteForce brute(scene);
        Rng rng(91 + static_cast<std::uint64_t>(s));
        for (int i = 0; i < rays; ++i) {
            const Ray ray = random_ray(rng);
            const Hit hit = accel.intersect(ray);
            const auto expected = brute.nearest(ray);
            ASSERT_EQ(accel.occluded(ray), hit.valid());
            const Flat* found = hit.valid() ? brute.find(hit) : nullptr;
            ASSERT_EQ(found != nullptr, hit.valid());
            if (found == expected.shape) {
                hits += hit.valid();
                if (hit.valid()) {
                    ASSERT_NEAR(hit.t, expected.at.t,
                                expected.at.t_error + 4 * epsilon * expected.at.t);
                }
                continue;
            }
            // Another shape: only where rounding may decide, at an outline or where two
            // shapes meet the ray at the same place.
            ++doubtful;
            if (found != nullptr) {
                const auto meeting = brute.meet(*found, ray);
                ASSERT_TRUE(meeting.has_value());
                const bool outline = std::fabs(meeting->margin) < 1;
                const bool same_place = expected.shape != nullptr &&
                                        std::fabs(meeting->t - expected.at.t) <=
                                            meeting->t_error + expected.at.t_error;
                const bool beside = expected.shape != nullptr && expected.at.margin < 1;
                ASSERT_TRUE(outline || same_place || beside) << "ray " << i;
            } else {
                ASSERT_LT(expected.at.margin, 1) << "ray " << i << " missed";
            }
        }
    }
    EXPECT_GT(hits, 300000);
    EXPECT_LT(hits, scenes * rays * 9 / 10);
    // An outline is about 1e-6 wide, and a ray passes some of some dozen shapes.
    EXPECT_LT(doubtful, scenes * rays / 10000);
}

TEST(Accel, BarycentricsAndNormalDescribeTheHit) {
    const Scene scene = random_scene(85);
    const Accel accel(scene);
    Rng rng(96);
    for (int i = 0; i < 50000; ++i) {
        const Ray ray = random_ray(rng);
        const Hit hit = accel.intersect(ray);
        if (!hit.valid() || hit.instance != no_index || hit.geometry >= 2) {
            continue;
        }
        const Mesh& mesh = scene.groups[0].meshes[hit.geometry];
        const std::uint32_t* v = mesh.indices + 3 * hit.primitive;
        const Vec3f p0 = mesh.position(v[0]), p1 = mesh.position(v[1]),
                    p2 = mesh.position(v[2]);
        const Vec3f p = p0 * (1 - hit.u - hit.v) + p1 * hit.u + p2 * hit.v;
        const Vec3f n = cross(p1 - p0, p2 - p0);
        // Coordinates up to 4, seen at an angle: the offset along the ray over its
        // cosine.
        const float cosine =
            std::fabs(dot(n, ray.direction)) / (length(n) * length(ray.direction));
        const float tolerance =
            16 * 0x1p-24f * 4 * (1 + 1 / max(cosine, 1e-3f)) + 64 * 0x1p-24f / length(n);
        EXPECT_LT(length(ray.origin + ray.direction * hit.t - p), tolerance);
        EXPECT_GT(dot(normalize(hit.normal), normalize(n)), 1 - 1e-4f);
    }
}

TEST(Accel, KeepsToTheRaysRange) {
    const Scene scene = random_scene(86);
    const Accel accel(scene);
    Rng rng(97);
    int tried = 0;
    for (int i = 0; i < 50000; ++i) {
        Ray ray = random_ray(rng);
        const Hit first = accel.intersect(ray);
        if (!first.valid()) {
            continue;
        }
        ++tried;
        ray.t_far = first.t * 0.9999f;
        ASSERT_FALSE(accel.intersect(ray).valid());
        ASSERT_FALSE(accel.occluded(ray));
        ray.t_near = first.t * 1.0001f;
        ray.t_far = infinity;
        const Hit second = accel.intersect(ray);
        ASSERT_TRUE(!second.valid() || second.t >= ray.t_near);
    }
    EXPECT_GT(tried, 10000);
}

TEST(Sphere, RootsFromInsideAndOutside) {
    const Vec3f center(1, 2, 3);
    const auto meet = [&](const Vec3f& o, const Vec3f& d, double near, double far) {
        return intersect_sphere(o, d, near, far, center, 2.0f);
    };
    EXPECT_DOUBLE_EQ(meet({1, 2, -7}, {0, 0, 1}, 0, 1e30), 8);
    EXPECT_DOUBLE_EQ(meet({1, 2, 3}, {0, 0, 2}, 0, 1e30), 1);
    EXPECT_DOUBLE_EQ(meet({1, 2, -7}, {0, 0, 1}, 9, 1e30), 12);
    EXPECT_LT(meet({1, 2, -7}, {0, 0, 1}, 0, 7), 0);
    EXPECT_LT(meet({1, 2, -7}, {0, 0, -1}, 0, 1e30), 0);
    EXPECT_LT(meet({4, 2, -7}, {0, 0, 1}, 0, 1e30), 0);
    // A small sphere far away keeps its roundness: 1e-3 across at 1e3.
    const double t =
        intersect_sphere({0, 0, 0}, {1, 0, 0}, 0, 1e30, {1000, 0.0003f, 0}, 5e-4f);
    EXPECT_NEAR(t, 1000 - 4e-4, 1e-8);
}

TEST(Accel, BoundsHoldInstances) {
    Scene scene;
    scene.groups.resize(2);
    Sphere s;
    s.center = {1, 0, 0};
    scene.groups[1].spheres.push_back(s);
    Transform m;
    m.x = {2, 0, 0};
    m.y = {0, 3, 0};
    m.origin = {10, 0, 0};
    scene.instances.push_back(test::make_instance(1, m));
    const Bounds b = Accel(scene).bounds();
    // The sphere's box is widened by 1e-5.
    EXPECT_NEAR(b.low.x, 10, 1e-3);
    EXPECT_NEAR(b.high.x, 14, 1e-3);
    EXPECT_NEAR(b.high.y, 3, 1e-3);
    EXPECT_NEAR(b.low.z, -1, 1e-3);
}

TEST(Accel, EmptyScenesMeetNothing) {
    const Scene scene;
    const Accel accel(scene);
    EXPECT_FALSE(accel.intersect({{0, 0, 0}, {0, 0, 1}}).valid());
    EXPECT_FALSE(accel.occluded({{0, 0, 0}, {0, 0, 1}}));
}

}  // namespace
}  // namespace raykiln
