#include "integrator/photons.h"

#include <algorithm>

#include "integrator/guided.h"
#include "light/sample_light.h"
#include "math/wide.h"

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

LightSample lane_of(const LightSampleOf<Wide>& s, int i) {
    return {lane_of(s.direction, i), lane_of(s.point, i),       s.infinite.lane(i),
            lane_of(s.radiance, i),  s.pdf_solid_angle.lane(i), s.delta.lane(i)};
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
        target.area = target.estimated_area();
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

float PhotonSource::Target::estimated_area() const {
    constexpr std::uint32_t enough = 4096;
    const std::uint32_t step = (mesh->triangle_count + enough - 1) / enough;
    float sum = 0;
    std::uint32_t taken = 0;
    for (std::uint32_t t = 0; t < mesh->triangle_count; t += step, ++taken) {
        sum += 0.5f * length(triangle(t).normal);
    }
    return sum / static_cast<float>(max(taken, 1u)) *
           static_cast<float>(mesh->triangle_count);
}

PhotonSource::Aim PhotonSource::aim(double place, const SampleKey<float>& key) const {
    const Sample4<float> u = independent_sample(key, 0);
    const double area_before = place * area_up_to_.back();
    const auto next =
        std::upper_bound(area_up_to_.begin(), area_up_to_.end() - 1, area_before);
    const Target& target = targets_[static_cast<std::size_t>(next - area_up_to_.begin())];
    if (target.mesh == nullptr) {
        const Vec3f normal = sample_sphere(u[2], u[3]);
        const Vec3f p = target.sphere->center + normal * target.sphere->radius;
        return {target.world_from_group.point(p), normal, area_};
    }
    const std::uint32_t count = target.mesh->triangle_count;
    const double share = (area_before - (*next - target.area)) / target.area;
    const auto t = static_cast<std::uint32_t>(
        std::clamp(share * count, 0.0, static_cast<double>(count - 1)));
    const Triangle triangle = target.triangle(t);
    const Vec2f at = sample_triangle(u[2], u[3]);
    const float twice_area = length(triangle.normal);
    if (!(twice_area > 0.0f)) {
        return {};
    }
    return {triangle.p + triangle.edge1 * at.x + triangle.edge2 * at.y,
            triangle.normal / twice_area,
            area_ * 0.5f * twice_area * static_cast<float>(count) / target.area};
}

/// Several at a time: a sky's tables are far from the processor, and one ray would wait
/// for them longer than it takes.
void PhotonSource::emit(std::uint32_t seed, std::size_t first, std::size_t total,
                        std::span<Emitted> rays) const {
    constexpr auto lanes = static_cast<std::size_t>(NumberTraits<Wide>::width);
    for (std::size_t begin = 0; begin < rays.size(); begin += lanes) {
        const std::size_t count = std::min(lanes, rays.size() - begin);
        const auto number = static_cast<std::uint32_t>(first + begin);
        std::array<Aim, lanes> aims;
        LightReceiverOf<Wide> receiver{Vec3<Wide>(Wide(0.0f)), Vec3<Wide>(Wide(0.0f))};
        for (std::size_t i = 0; i < count; ++i) {
            const std::size_t n = first + begin + i;
            const double place =
                (static_cast<double>(n) + 0.5) / static_cast<double>(total);
            aims[i] = aim(place, {seed, static_cast<std::uint32_t>(n)});
            set_lane(receiver.p, static_cast<int>(i), aims[i].p);
        }
        const SampleKey<Wide> key{WideUint(seed), iota<WideUint>() + WideUint(number)};
        const Sample4<Wide> u = independent_sample(key, 1);
        const LightChoiceOf<Wide> choice = choose_light(scene_, receiver, u[0]);
        const LightSampleOf<Wide> sample = sample_light(
            scene_, choice.light, choice.pmf > Wide(0.0f), receiver, u[1], u[2], u[3]);
        for (std::size_t i = 0; i < count; ++i) {
            const auto lane = static_cast<int>(i);
            rays[begin + i] = emitted(aims[i], choice.light.lane(lane),
                                      choice.pmf.lane(lane), lane_of(sample, lane));
        }
    }
}

Emitted PhotonSource::emitted(const Aim& aim, std::uint32_t light, float pmf,
                              const LightSample& sample) const {
    const float density = pmf * sample.pdf_solid_angle;
    if (sample.delta || !(density > 0.0f) || !(aim.area > 0.0f)) {
        return {};
    }
    const float power = luminance(sample.radiance) *
                        bright_share(scene_.lights[light], sample.radiance) *
                        std::fabs(dot(aim.normal, sample.direction)) * aim.area / density;
    const Vec3f from =
        sample.infinite ? aim.p + sample.direction * far_distance_ : sample.point;
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
