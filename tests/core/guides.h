#pragma once

#include <utility>
#include <vector>

#include "directions.h"
#include "guide/caustic_guide.h"

// A guide that has learned from given photons, for the proofs of guide/ and
// integrator/guided.h.

namespace raykiln::test {

inline Vec3f near_direction(const Vec3f& direction, float spread, Rng& rng) {
    return normalize(direction + test::random_direction(rng) * (spread * rng.unit()));
}

/// Photons at random places of a flat square about `center`, from directions that
/// `direction_of(number)` tells.
template <class DirectionOf>
void add_square(std::vector<Photon>& photons, std::size_t count, const Vec3f& center,
                Rng& rng, const DirectionOf& direction_of) {
    for (std::size_t i = 0; i < count; ++i) {
        const Vec3f off(rng.between(-0.5f, 0.5f), rng.between(-0.5f, 0.5f), 0.0f);
        photons.push_back({center + off, direction_of(i)});
    }
}

constexpr float little = 1e-3f;  // irradiance beside which any focused light is strong
inline const Vec3f up{0, 0, 1};
inline const Vec3f aside{0.6f, 0, 0.8f};

inline CausticGuide learned(std::vector<Photon> photons, float irradiance = little) {
    return CausticGuide(std::move(photons), irradiance, 1.0f);
}

/// Where light comes from one direction, from everywhere, and from two sides.
struct Place {
    const char* name;
    Vec3f p;
    double zoom;  ///< width of lobes that look wide through it
};
inline const Place places[] = {
    {"narrow", {-4, 0, 0}, 3e-5}, {"wide", {0, 0, 0}, 1e6}, {"mixed", {4, 0, 0}, 3e-3}};

inline CausticGuide guide_of_places() {
    Rng rng(201);
    std::vector<Photon> photons;
    add_square(photons, 768, places[0].p, rng,
               [&](std::size_t) { return near_direction(up, 0.004f, rng); });
    add_square(photons, 768, places[1].p, rng,
               [&](std::size_t) { return test::random_direction(rng); });
    add_square(photons, 768, places[2].p, rng, [&](std::size_t i) {
        return i % 2 == 0 ? near_direction(up, 0.03f, rng)
                          : near_direction(aside, 0.5f, rng);
    });
    return learned(std::move(photons));
}

}  // namespace raykiln::test
