#include <benchmark/benchmark.h>

#include <functional>
#include <string>

#include "trace.h"

// Rays a second of the ray tracer alone: the limit of any render with the same rays.

namespace raykiln::bench {

namespace {

using benchmark::State;

struct Case {
    View view;
    Accel accel;
    RaySet rays;

    Case(View v, int size) :
        view(std::move(v)),
        accel(view.scene),
        rays(record_rays(view, accel, size)) {}
};

const Case& cornell() {
    static const Case c(cornell_box(), 256);
    return c;
}
const Case& ball() {
    static const Case c(displaced_ball(8), 512);
    return c;
}

using CaseOf = const Case& (*)();
using RaysOf = std::vector<Ray> RaySet::*;

void add(const std::string& name, CaseOf make, RaysOf kind,
         std::size_t (*run)(const Accel&, const std::vector<Ray>&)) {
    benchmark::RegisterBenchmark(name.c_str(), [=](State& state) {
        const Case& c = make();
        const auto& rays = c.rays.*kind;
        std::size_t met = 0;
        for ([[maybe_unused]] auto _ : state) {
            met = run(c.accel, rays);
            benchmark::DoNotOptimize(met);
        }
        state.SetItemsProcessed(state.iterations() *
                                static_cast<std::int64_t>(rays.size()));
        state.counters["hit"] =
            static_cast<double>(met) / static_cast<double>(rays.size());
    })->Unit(benchmark::kMillisecond);
}

template <int N, class Run>
void add_packets(const std::string& name, CaseOf make, RaysOf kind, Run run) {
    benchmark::RegisterBenchmark(
        (name + "/packet" + std::to_string(N)).c_str(),
        [=](State& state) {
            const Case& c = make();
            const auto packets = make_packets<N>(c.rays.*kind);
            std::size_t met = 0;
            for ([[maybe_unused]] auto _ : state) {
                met = run(c.accel, packets);
                benchmark::DoNotOptimize(met);
            }
            const auto count = static_cast<std::int64_t>((c.rays.*kind).size());
            state.SetItemsProcessed(state.iterations() * count);
            state.counters["hit"] = static_cast<double>(met) / static_cast<double>(count);
        })
        ->Unit(benchmark::kMillisecond);
}

template <int N>
void add_all_packets(const std::string& scene, CaseOf make) {
    const auto nearest = [](bool coherent) {
        return [coherent](const Accel& accel, const std::vector<RayPacket<N>>& p) {
            return trace_packets<N>(accel, p, coherent);
        };
    };
    add_packets<N>(scene + "/primary/coherent", make, &RaySet::primary, nearest(true));
    add_packets<N>(scene + "/primary/incoherent", make, &RaySet::primary, nearest(false));
    add_packets<N>(scene + "/bounce/coherent", make, &RaySet::bounce, nearest(true));
    add_packets<N>(scene + "/bounce/incoherent", make, &RaySet::bounce, nearest(false));
    add_packets<N>(scene + "/occlusion", make, &RaySet::shadow, occlude_packets<N>);
}

void add_scene(const std::string& scene, CaseOf make) {
    add(scene + "/primary/single", make, &RaySet::primary, trace_single);
    add(scene + "/bounce/single", make, &RaySet::bounce, trace_single);
    add(scene + "/occlusion/single", make, &RaySet::shadow, occlude_single);
    add_all_packets<4>(scene, make);
    add_all_packets<8>(scene, make);
    add_all_packets<16>(scene, make);
}

[[maybe_unused]] const bool registered = [] {
    add_scene("rays/cornell", cornell);
    add_scene("rays/ball", ball);
    return true;
}();

}  // namespace

}  // namespace raykiln::bench
