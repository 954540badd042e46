#include "sampling/light_tree.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

#include "math/elementary.h"

namespace raykiln {

namespace {

float sin_of(float cosine) {
    return safe_sqrt(1.0f - cosine * cosine);
}

/// The narrowest cone of directions that holds two cones.
void join_cones(LightBounds& a, const LightBounds& b) {
    if (a.two_sided && dot(a.axis, b.axis) < 0.0f) {
        // Both sides count, so either axis does.
        LightBounds turned = b;
        turned.axis = -b.axis;
        join_cones(a, turned);
        return;
    }
    const float angle_a = acos(a.cos_theta_o), angle_b = acos(b.cos_theta_o);
    const float between = acos(dot(a.axis, b.axis));
    if (min(between + angle_b, pi) <= angle_a) {
        return;
    }
    if (min(between + angle_a, pi) <= angle_b) {
        a.axis = b.axis;
        a.cos_theta_o = b.cos_theta_o;
        return;
    }
    const float joined = 0.5f * (angle_a + between + angle_b);
    const Vec3f aside = b.axis - a.axis * dot(a.axis, b.axis);
    if (joined >= pi || length_squared(aside) < 1e-12f) {
        a.cos_theta_o = -1.0f;
        return;
    }
    float sine, cosine;
    sin_cos_turns((joined - angle_a) * inv_two_pi, sine, cosine);
    a.axis = normalize(a.axis * cosine + normalize(aside) * sine);
    sin_cos_turns(joined * inv_two_pi, sine, cosine);
    a.cos_theta_o = cosine;
}

LightBounds joined(const LightBounds& a, const LightBounds& b) {
    if (a.bounds.empty()) {
        return b;
    }
    LightBounds sum = a;
    sum.bounds.add(b.bounds);
    sum.power += b.power;
    sum.two_sided = a.two_sided || b.two_sided;
    join_cones(sum, b);
    sum.cos_theta_e = min(a.cos_theta_e, b.cos_theta_e);
    return sum;
}

/// Cost of a cluster: its power, times the solid angle it emits into, times its surface
/// area.
float cluster_cost(const LightBounds& b, float regularity) {
    if (b.bounds.empty()) {
        return 0.0f;
    }
    const float theta_o = acos(b.cos_theta_o), theta_e = acos(b.cos_theta_e);
    const float theta_w = min(theta_o + theta_e, pi);
    const float sin_o = sin_of(b.cos_theta_o);
    float sine, cosine;
    sin_cos_turns((theta_o - 2.0f * theta_w) * inv_two_pi, sine, cosine);
    const float solid =
        two_pi * (1.0f - b.cos_theta_o) +
        0.5f * pi *
            (2.0f * theta_w * sin_o - cosine - 2.0f * theta_o * sin_o + b.cos_theta_o);
    const Vec3f d = b.bounds.extent();
    return b.power * solid * regularity * (d.x * d.y + d.y * d.z + d.z * d.x);
}

struct Split {
    float cost = infinity;
    int axis = -1;
    float position = 0.0f;
};

/// The cheapest of the binned planes across the lights' centres.
Split best_split(const std::vector<std::uint32_t>& order, std::size_t begin,
                 std::size_t end, const std::vector<LightBounds>& lights,
                 const LightBounds& total, const Bounds& centers) {
    constexpr std::size_t bins = 12;
    const Vec3f size = total.bounds.extent();
    Split best;
    for (int axis = 0; axis < 3; ++axis) {
        const float low = component(centers.low, axis),
                    width = component(centers.extent(), axis);
        if (!(width > 0.0f)) {
            continue;
        }
        std::array<LightBounds, bins> bin;
        for (std::size_t i = begin; i < end; ++i) {
            const LightBounds& light = lights[order[i]];
            const float at = (component(light.bounds.center(), axis) - low) / width;
            const auto b = std::min(static_cast<std::size_t>(at * bins), bins - 1);
            bin[b] = joined(bin[b], light);
        }
        std::array<float, bins> above{};
        LightBounds run;
        const float regularity = max_component(size) / max(component(size, axis), 1e-20f);
        for (std::size_t b = bins - 1; b > 0; --b) {
            run = bin[b].bounds.empty() ? run : joined(run, bin[b]);
            above[b] = cluster_cost(run, regularity);
        }
        run = {};
        for (std::size_t b = 1; b < bins; ++b) {
            run = bin[b - 1].bounds.empty() ? run : joined(run, bin[b - 1]);
            const float cost = cluster_cost(run, regularity) + above[b];
            if (cost < best.cost) {
                best = {cost, axis, low + width * static_cast<float>(b) / bins};
            }
        }
    }
    return best;
}

/// The intensity of lights, averaged: amplitude x (forward . w + sqrt(w . even w)) in
/// direction w from them, of which `forward` holds what one side has more than the other,
/// and `even` (symmetric, trace 1) what both have. Exact for one light.
struct Lobe {
    float amplitude = 0.0f;
    Vec3f forward{0, 0, 0};       // times the amplitude
    std::array<float, 6> even{};  // xx, yy, zz, xy, xz, yz; times the amplitude

    void add(const Lobe& b) {
        amplitude += b.amplitude;
        forward += b.forward;
        for (std::size_t i = 0; i < even.size(); ++i) {
            even[i] += b.even[i];
        }
    }
    float even_along(const Vec3f& a) const {
        return even[0] * a.x * a.x + even[1] * a.y * a.y + even[2] * a.z * a.z +
               2.0f * (even[3] * a.x * a.y + even[4] * a.x * a.z + even[5] * a.y * a.z);
    }
};

Lobe lobe_of(const LightBounds& b) {
    Lobe lobe;
    const bool surface = b.cos_theta_o == 1.0f && b.cos_theta_e == 0.0f;
    if (!surface) {
        // Alike in all directions, or within a cone.
        const bool cone = b.cos_theta_o == 1.0f;
        const float solid_angle = two_pi * (cone ? 1.0f - b.cos_theta_e : 2.0f);
        lobe.amplitude = std::sqrt(3.0f) * b.power / max(solid_angle, 1e-6f);
        lobe.even = {1.0f / 3.0f, 1.0f / 3.0f, 1.0f / 3.0f, 0, 0, 0};
    } else {
        // By the cosine: (cos + |cos|) / 2, or |cos|; twice the power on two sides.
        const Vec3f& n = b.axis;
        lobe.amplitude = b.power * 0.5f * inv_pi;
        lobe.forward = b.two_sided ? Vec3f(0.0f) : n * lobe.amplitude;
        lobe.even = {n.x * n.x, n.y * n.y, n.z * n.z, n.x * n.y, n.x * n.z, n.y * n.z};
    }
    for (float& e : lobe.even) {
        e *= lobe.amplitude;
    }
    return lobe;
}

/// The upper half of a float's bits, rounded up in size.
std::uint32_t upper_half(float x) {
    return (std::bit_cast<std::uint32_t>(x) + 0xffffu) >> 16;
}

std::uint32_t byte_above(float x) {
    return static_cast<std::uint32_t>(clamp(std::ceil(x), 0.0f, 255.0f));
}

/// Two floats in a word, each to within 2^-8: `first` is read with `second` as its low
/// bits. It is 1e-19 at least: beside a zero they would make a denormal, which is slow.
std::uint32_t pair(float first, float second) {
    const std::uint32_t low = (std::bit_cast<std::uint32_t>(second) + 0x8000u) >> 16;
    const std::uint32_t size =
        std::bit_cast<std::uint32_t>(max(std::fabs(first), 1e-19f));
    const std::uint32_t sign = std::bit_cast<std::uint32_t>(first) & 0x80000000u;
    return sign | ((size - low + 0x8000u) & 0xffff0000u) | low;
}

int widest_axis(const Bounds& b) {
    const Vec3f e = b.extent();
    if (e.x >= e.y && e.x >= e.z) {
        return 0;
    }
    return e.y >= e.z ? 1 : 2;
}

}  // namespace

/// Splits ranges of lights until each is one, in as few levels as they fit into: a batch
/// of paths takes as many steps as the deepest of its lights has.
struct LightTree::Builder {
    LightTree& tree;
    const std::vector<LightBounds>& lights;
    std::vector<std::uint32_t> order;

    struct Range {
        std::size_t begin, end;
        std::size_t size() const { return end - begin; }
        /// How many children it takes, with `most` lights below each.
        std::size_t children(std::size_t most) const {
            return (size() + most - 1) / most;
        }
    };

    static constexpr std::size_t fanout = 4;

    /// The index that divides a range in two, neither empty, by the cheapest plane that
    /// lets the parts fit into `children` of at most `most` lights; else near its middle.
    std::size_t split(const Range& range, std::size_t children, std::size_t most) {
        LightBounds total;
        Bounds centers;
        for (std::size_t i = range.begin; i < range.end; ++i) {
            total = joined(total, lights[order[i]]);
            centers.add(lights[order[i]].bounds.center());
        }
        const auto fits = [&](std::size_t middle) {
            const Range low{range.begin, middle}, high{middle, range.end};
            return low.size() > 0 && high.size() > 0 &&
                   low.children(most) + high.children(most) <= children;
        };
        const auto iterator = [&](std::size_t i) {
            return order.begin() + static_cast<std::ptrdiff_t>(i);
        };
        const auto along = [&](std::uint32_t light, int axis) {
            return component(lights[light].bounds.center(), axis);
        };
        const Split best =
            best_split(order, range.begin, range.end, lights, total, centers);
        if (best.axis >= 0) {
            const auto middle = std::partition(
                iterator(range.begin), iterator(range.end), [&](std::uint32_t light) {
                    return along(light, best.axis) < best.position;
                });
            const auto at = static_cast<std::size_t>(middle - order.begin());
            if (fits(at)) {
                return at;
            }
        }
        const int axis = widest_axis(centers);
        const std::size_t half = range.begin + range.size() / 2;
        const std::size_t third = range.begin + range.size() / 3;
        const std::size_t at = fits(half) ? half : third;
        std::nth_element(iterator(range.begin), iterator(at), iterator(range.end),
                         [&](std::uint32_t a, std::uint32_t b) {
                             const float of_a = along(a, axis), of_b = along(b, axis);
                             return of_a < of_b || (of_a == of_b && a < b);
                         });
        return at;
    }

    /// Up to four parts of at most `most` lights: of those so far, the one with the most
    /// lights is split.
    std::vector<Range> parts(const Range& range, std::size_t most) {
        std::vector<Range> all{range};
        std::size_t children = range.children(most);
        while (all.size() < fanout) {
            const auto largest = std::max_element(
                all.begin(), all.end(),
                [](const Range& a, const Range& b) { return a.size() < b.size(); });
            if (largest->size() < 2) {
                break;
            }
            const std::size_t others = children - largest->children(most);
            const std::size_t middle = split(*largest, fanout - others, most);
            const Range low{largest->begin, middle}, high{middle, largest->end};
            children = others + low.children(most) + high.children(most);
            *largest = low;
            all.insert(largest + 1, high);
        }
        return all;
    }

    Cluster cluster(const Range& range) const {
        LightBounds b;
        Lobe lobe;
        for (std::size_t i = range.begin; i < range.end; ++i) {
            b = joined(b, lights[order[i]]);
            lobe.add(lobe_of(lights[order[i]]));
        }
        // A light is out of reach behind planes across the axis of its normals, or
        // outside a cone about it: axis . w + lean + behind / distance < 0.
        const float theta = acos(b.cos_theta_o) + acos(b.cos_theta_e);
        const float theta_total = b.two_sided ? pi : min(theta, pi);
        float unused, cos_total;
        sin_cos_turns(theta_total * inv_two_pi, unused, cos_total);
        const Vec3f half = b.bounds.extent() * 0.5f;
        const float radius = max(length(half), 1e-10f);
        const float through = std::fabs(b.axis.x) * half.x +
                              std::fabs(b.axis.y) * half.y + std::fabs(b.axis.z) * half.z;
        // The axis has 8 bits a component, distances are rough.
        const float lean = 0.008f - cos_total;
        const float behind = through + std::fabs(lean) * radius;

        const float along = clamp(lobe.even_along(b.axis) / lobe.amplitude, 0.0f, 1.0f);
        const float forward = dot(lobe.forward, b.axis) / lobe.amplitude;
        Cluster c;
        c.center = b.bounds.center();
        c.amplitude_aside = pair(lobe.amplitude, 0.5f * (1.0f - along));
        c.axis_xy = pair(b.axis.x, b.axis.y);
        c.axis_z_forward = pair(b.axis.z, clamp(forward, -1.0f, 1.0f));
        c.radius_reach = upper_half(radius) << 16 |
                         byte_above(behind / (radius * behind_step)) << 8 |
                         byte_above((lean + 1.0f) / lean_step);
        c.next = 0;
        return c;
    }

    /// Beside a light, its estimate is a rough one. And a cluster whose lights stand
    /// close together in a wider one counts for more than its part of that, within some
    /// distance: where its own intensity over the distance squared is what the wider one
    /// is taken for in its midst (`contribution`), or a quarter of it. `spread`: the
    /// greatest radius over the root of the intensity of those around it.
    void keep_clear_of(float amplitude, float radius, float spread, bool single) {
        const float distance = spread * std::sqrt(0.5f * amplitude);
        if (single || distance > radius) {
            tree.clearance_ = max(tree.clearance_, max(distance, radius));
        }
    }

    /// Fills a node, `level` below the root, and all below it: `most` lights at most
    /// under each child; `spread` as above.
    void build(std::uint32_t index, int level, std::uint32_t path, const Range& range,
               std::size_t most, float spread) {
        const std::vector<Range> children = parts(range, most);
        for (std::uint32_t i = 0; i < children.size(); ++i) {
            const Range& child = children[i];
            Cluster c = cluster(child);
            const float amplitude = as_float(c.amplitude_aside);
            const float radius = as_float(c.radius_reach);
            keep_clear_of(amplitude, radius, spread, child.size() == 1);
            const std::uint32_t path_here = path | i << (2 * level);
            if (child.size() == 1) {
                const std::uint32_t light = order[child.begin];
                c.next = light | is_light;
                tree.path_of_light_[light] = path_here;
                tree.nodes_[index].child[i] = c;
                continue;
            }
            c.next = static_cast<std::uint32_t>(tree.nodes_.size());
            tree.nodes_[index].child[i] = c;
            tree.nodes_.emplace_back();
            build(c.next, level + 1, path_here, child, most / fanout,
                  max(spread, radius / std::sqrt(amplitude)));
        }
    }
};

LightTree::LightTree(const std::vector<LightBounds>& lights) :
    path_of_light_(lights.size(), none),
    place_of_light_(lights.size(), 0) {
    Builder builder{*this, lights, {}};
    float least_radiance = infinity;
    for (std::uint32_t i = 0; i < lights.size(); ++i) {
        least_radiance = min(least_radiance, lights[i].radiance);
        if (lights[i].power > 0.0f) {
            bounds_.add(lights[i].bounds);
            builder.order.push_back(i);
        }
    }
    if (builder.order.empty()) {
        return;
    }
    // A contribution is made of twice the cosines, and half the area times the radiance.
    small_total_ = 2.0f * pi * small_share * least_radiance;
    nodes_.emplace_back();
    size_ = builder.order.size();
    std::size_t most = 1;
    while (most * Builder::fanout < size_) {
        most *= Builder::fanout;
    }
    builder.build(0, 0, 0, {0, size_}, most, 0.0f);
    for (std::size_t i = 0; i < size_; ++i) {
        place_of_light_[builder.order[i]] =
            static_cast<std::uint32_t>(i * places / size_);
    }
}

}  // namespace raykiln
