#include "scenes.h"

#include "../../tests/core/shapes.h"
#include "light/light.h"

namespace raykiln::bench {

namespace {

using test::Triangles;

enum MaterialIndex : std::uint32_t { white, red, green };

void add_quad(Triangles& t, const Vec3f& corner, const Vec3f& u, const Vec3f& v) {
    const auto first = static_cast<std::uint32_t>(t.positions.size());
    t.positions.insert(t.positions.end(),
                       {corner, corner + u, corner + u + v, corner + v});
    t.faces.push_back({first, first + 1, first + 2});
    t.faces.push_back({first, first + 2, first + 3});
}

/// The five faces of a box that stands on the floor, turned about the vertical.
void add_box(Triangles& t, const Vec3f& foot, float width, float height, float turns) {
    float sine, cosine;
    sin_cos_turns(turns, sine, cosine);
    const Vec3f x = Vec3f{cosine, 0, sine} * width, z = Vec3f{-sine, 0, cosine} * width;
    const Vec3f y{0, height, 0}, corner = foot - (x + z) * 0.5f;
    add_quad(t, corner + y, z, x);
    add_quad(t, corner, y, x);
    add_quad(t, corner + z, x, y);
    add_quad(t, corner, z, y);
    add_quad(t, corner + x, y, z);
}

void add_mesh(Scene& scene, const Triangles& t, std::uint32_t material,
              std::uint32_t emission = no_index) {
    Mesh mesh = test::make_mesh(t);
    mesh.material = material;
    mesh.emission = emission;
    scene.groups[0].meshes.push_back(mesh);
}

void add_diffuse(Scene& scene, const Vec3f& reflectance) {
    Material material;
    material.kind = DiffuseMaterial{ColorSlot{reflectance}};
    scene.materials.push_back(material);
}

Camera camera_at(const Vec3f& origin, float tan_half) {
    Camera camera;
    camera.origin = origin;
    camera.tan_half_x = camera.tan_half_y = tan_half;
    return camera;
}

/// The room from (-1, -1, -1) to (1, 1, 1), open towards +z, without its light.
Scene room() {
    Scene scene;
    add_diffuse(scene, Vec3f(0.73f));
    add_diffuse(scene, {0.65f, 0.05f, 0.05f});
    add_diffuse(scene, {0.12f, 0.45f, 0.15f});
    Triangles walls, left, right;
    add_quad(walls, {-1, -1, 1}, {2, 0, 0}, {0, 0, -2});
    add_quad(walls, {-1, 1, -1}, {2, 0, 0}, {0, 0, 2});
    add_quad(walls, {-1, -1, -1}, {2, 0, 0}, {0, 2, 0});
    add_box(walls, {0.33f, -1, 0.35f}, 0.6f, 0.6f, 0.05f);
    add_box(walls, {-0.33f, -1, -0.3f}, 0.6f, 1.2f, -0.05f);
    add_quad(left, {-1, -1, 1}, {0, 0, -2}, {0, 2, 0});
    add_quad(right, {1, -1, -1}, {0, 0, 2}, {0, 2, 0});
    add_mesh(scene, walls, white);
    add_mesh(scene, left, red);
    add_mesh(scene, right, green);
    return scene;
}

}  // namespace

View cornell_box() {
    Scene scene = room();
    scene.emissions.push_back({ColorSlot{{17, 12, 4}}, 0});
    Triangles light;
    add_quad(light, {-0.24f, 0.99f, -0.22f}, {0.47f, 0, 0}, {0, 0, 0.38f});
    add_mesh(scene, light, white, 0);
    prepare_lights(scene);
    return {std::move(scene), camera_at({0, 0, 3.9f}, 0.35f)};
}

View displaced_ball(int levels) {
    Scene scene;
    add_diffuse(scene, Vec3f(0.6f));
    test::Rng rng(1);
    add_mesh(scene, test::make_ball(levels, {0, 0, 0}, 1.0f, 0.05f, rng), white);
    Triangles plane;
    add_quad(plane, {-10, -1, 10}, {20, 0, 0}, {0, 0, -20});
    add_mesh(scene, plane, white);
    scene.lights.emplace_back(EnvironmentLight{});
    prepare_lights(scene);
    return {std::move(scene), camera_at({0, 0.2f, 4.0f}, 0.4f)};
}

View many_lights(std::uint32_t count) {
    Scene scene = room();
    scene.emissions.push_back({ColorSlot{{5, 5, 5}}, 0});
    test::Rng rng(2);
    add_mesh(scene, test::make_soup(count, 0.01f, rng), white, 0);
    prepare_lights(scene);
    return {std::move(scene), camera_at({0, 0, 3.9f}, 0.35f)};
}

}  // namespace raykiln::bench
