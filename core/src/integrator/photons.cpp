#include "integrator/photons.h"

#include <algorithm>

#include "integrator/guided.h"
#include "light/light.h"

namespace raykiln {

namespace {

/// Light sent is followed over at most as many surfaces.
constexpr int longest_chain = 16;
/// Density over solid angle from which on scattering counts as focusing.
constexpr float sharp = 100.0f;
/// Roughness up to which a surface may do so.
constexpr float roughest_alpha = 0.03f;
/// Sky light counts as far as it exceeds this multiple of its mean over the sky: the rest
/// is smooth enough to be found without a guide.
constexpr float bright = 4.0f;

bool is_smooth(const FloatSlot& alpha) {
    return alpha.texture == no_texture && alpha.factor <= roughest_alpha;
}
struct Focuses {
    bool operator()(const DiffuseMaterial&) const { return false; }
    bool operator()(const ConductorMaterial& m) const {
        return is_smooth(m.surface.alpha_u) && is_smooth(m.surface.alpha_v);
    }
    bool operator()(const DielectricMaterial& m) const {
        return m.thin || m.is_smooth() ||
               (is_smooth(m.surface.alpha_u) && is_smooth(m.surface.alpha_v));
    }
    bool operator()(const PlasticMaterial&) const { return false; }
    bool operator()(const PrincipledMaterial& m) const {
        const bool clear = m.metallic.factor > 0.5f || m.transmission.factor > 0.0f;
        return clear && m.roughness.texture == no_texture &&
               sqr(m.roughness.factor) <= roughest_alpha;
    }
};
bool focuses(const Material& m) {
    return std::visit(Focuses{}, m.kind);
}

/// The share of a sky's radiance that counts.
float bright_share(const Light& light, const Vec3f& radiance) {
    const auto* sky = std::get_if<EnvironmentLight>(&light);
    if (sky == nullptr) {
        return 1.0f;
    }
    const float mean = sky->power / (4.0f * pi);
    return max(1.0f - bright * mean / max(luminance(radiance), 1e-30f), 0.0f);
}

}  // namespace

PhotonSource::PhotonSource(const Scene& scene) : scene_(scene) {
    if (scene.lights.empty()) {
        return;
    }
    add_targets(scene.groups[0], Transform{});
    for (const Instance& instance : scene.instances) {
        add_targets(scene.groups[instance.group], instance.world_from_group);
    }
    if (targets_.empty()) {
        return;
    }
    double area = 0;
    for (const Target& target : targets_) {
        area += target.area;
        area_up_to_.push_back(area);
    }
    area_ = static_cast<float>(area);
    far_distance_ = 2.0f * length(scene.bounds.extent());
}

void PhotonSource::add_targets(const Group& group, const Transform& world_from_group) {
    const auto focusing = [&](const auto& shape) {
        return focuses(scene_.materials[shape.material]);
    };
    for (const Mesh& mesh : group.meshes) {
        if (!focusing(mesh)) {
            continue;
        }
        Target target{&mesh, nullptr, world_from_group, 0.0f};
        for (std::uint32_t t = 0; t < mesh.triangle_count; ++t) {
            target.area += 0.5f * length(target.triangle(t).normal);
        }
        if (target.area > 0.0f) {
            targets_.push_back(target);
        }
    }
    for (const Sphere& sphere : group.spheres) {
        if (focusing(sphere)) {
            const float scale = std::cbrt(std::fabs(world_from_group.determinant()));
            targets_.push_back({nullptr, &sphere, world_from_group,
                                4.0f * pi * sqr(sphere.radius * scale)});
        }
    }
}

PhotonSource::Triangle PhotonSource::Target::triangle(std::uint32_t number) const {
    const std::uint32_t* v = mesh->indices + 3 * static_cast<std::size_t>(number);
    const Vec3f p = world_from_group.point(mesh->position(v[0]));
    const Vec3f edge1 = world_from_group.point(mesh->position(v[1])) - p;
    const Vec3f edge2 = world_from_group.point(mesh->position(v[2])) - p;
    return {p, edge1, edge2, cross(edge1, edge2)};
}

Emitted PhotonSource::emit(double place, const SampleKey<float>& key) const {
    const Sample4<float> u = independent_sample(key, 0);
    const double area_before = place * area_up_to_.back();
    const auto next =
        std::upper_bound(area_up_to_.begin(), area_up_to_.end() - 1, area_before);
    const Target& target = targets_[static_cast<std::size_t>(next - area_up_to_.begin())];
    Vec3f p, normal;
    float area = area_;
    if (target.mesh != nullptr) {
        const std::uint32_t count = target.mesh->triangle_count;
        const double share = (area_before - (*next - target.area)) / target.area;
        const auto t = static_cast<std::uint32_t>(
            std::clamp(share * count, 0.0, static_cast<double>(count - 1)));
        const Triangle triangle = target.triangle(t);
        const Vec2f at = sample_triangle(u[2], u[3]);
        p = triangle.p + triangle.edge1 * at.x + triangle.edge2 * at.y;
        const float twice_area = length(triangle.normal);
        if (!(twice_area > 0.0f)) {
            return {};
        }
        normal = triangle.normal / twice_area;
        area *= 0.5f * twice_area * static_cast<float>(count) / target.area;
    } else {
        normal = sample_sphere(u[2], u[3]);
        p = target.world_from_group.point(target.sphere->center +
                                          normal * target.sphere->radius);
    }
    const Sample4<float> w = independent_sample(key, 1);
    const LightReceiver receiver{p, Vec3f{}};
    const LightTree::Choice choice = choose_light(scene_, receiver, w[0]);
    if (!(choice.pmf > 0.0f)) {
        return {};
    }
    const Light& light = scene_.lights[choice.light];
    const LightSample sample = sample_light(scene_, light, receiver, w[1], w[2], w[3]);
    if (sample.delta || !(sample.pdf_solid_angle > 0.0f)) {
        return {};
    }
    const float density = choice.pmf * sample.pdf_solid_angle;
    const float power = luminance(sample.radiance) *
                        bright_share(light, sample.radiance) *
                        std::fabs(dot(normal, sample.direction)) * area / density;
    const Vec3f from =
        sample.infinite ? p + sample.direction * far_distance_ : sample.point;
    return {{from, -sample.direction}, std::isfinite(power) ? power : 0.0f, density};
}

std::vector<std::uint32_t> equal_in_power(const std::vector<Emitted>& rays,
                                          std::size_t most) {
    double total = 0;
    std::size_t count = 0;
    for (const Emitted& ray : rays) {
        total += ray.power;
        count += ray.power > 0.0f ? 1 : 0;
    }
    count = std::min(count, most);
    std::vector<std::uint32_t> chosen;
    // Systematic resampling: a comb of even teeth over the running sum.
    const double step = total / static_cast<double>(count);
    double sum = 0;
    for (std::uint32_t i = 0; i < rays.size(); ++i) {
        sum += rays[i].power;
        while (chosen.size() < count &&
               (static_cast<double>(chosen.size()) + 0.5) * step <= sum) {
            chosen.push_back(i);
        }
    }
    while (chosen.size() < count) {  // rounding
        chosen.push_back(chosen.back());
    }
    return chosen;
}

void trace_photon(const Context& c, Ray ray, std::vector<Photon>& photons) {
    bool focused = false;
    for (int depth = 1; depth <= longest_chain; ++depth) {
        const Hit hit = trace(c, ray, bsdf_group(depth));
        if (!hit.valid()) {
            return;
        }
        const Surface s = make_surface(c.scene, hit, ray);
        const Bsdf bsdf = make_bsdf(*s.material, c.scene.textures, s.uv);
        if (focused && is_guided(bsdf) && !is_specular(bsdf)) {
            photons.push_back({s.p, -ray.direction});
        }
        const Sample4<float> u = independent_sample(c.key, bsdf_group(depth));
        // Squared, the number finds a faint reflection by the root of its probability. A
        // path from the camera meets it by the whole of it, so that its noise, which the
        // guide is to fit, goes by that root.
        const BsdfSample<float> next =
            sample(bsdf, s.shading.to_local(-ray.direction), {sqr(u[2]), u[0], u[1]});
        const bool sharply = next.specular || next.pdf_solid_angle > sharp;
        // Light, unlike radiance, does not change with the index that it enters.
        if (!sharply || !(u[3] < max_component(next.weight) * sqr(next.eta))) {
            return;
        }
        focused = true;
        ray = spawn_ray(s, normalize(s.shading.to_world(next.dir_in)));
    }
}

}  // namespace raykiln
