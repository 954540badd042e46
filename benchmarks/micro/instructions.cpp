#include <cstdio>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "camera/camera.h"
#include "integrator/context.h"
#include "shading_kernels.h"
#include "trace.h"
#include "wide/dispatch.h"

// Fixed amounts of work whose instructions are counted: `raykiln_instructions --list`
// names them, `raykiln_instructions NAME` does one. Only what runs inside
// `raykiln_counted_region` is to be counted.

extern "C" [[gnu::noipa]] void raykiln_counted_region(const std::function<void()>& work) {
    work();
    asm volatile("" ::: "memory");
}

namespace raykiln::bench {

namespace {

volatile float sink;

struct Workload {
    std::string name;
    std::function<void()> run;
};

void count_shading(const ShadingKernel& kernel) {
    const View view = many_lights(1000);
    const ShadingInputs inputs(view.scene);
    sink = kernel.run(inputs);  // tables and page faults are not of interest
    raykiln_counted_region([&] { sink = kernel.run(inputs); });
}

void count_rays(const View& view, int size,
                const std::function<std::size_t(const Accel&, const RaySet&)>& trace) {
    const Accel accel(view.scene);
    const RaySet rays = record_rays(view, accel, size);
    sink = static_cast<float>(trace(accel, rays));
    raykiln_counted_region([&] { sink = static_cast<float>(trace(accel, rays)); });
}

constexpr int image_size = 32, samples = 16;

EstimatorSettings settings_without_roulette() {
    EstimatorSettings settings;
    settings.rr_depth = settings.max_depth;
    return settings;
}

// Without the renderer, which works in threads of its own: those are not counted.

void count_batches(const View& view) {
    const Accel accel(view.scene);
    const Filter filter(FilterKind::box);
    const BatchScene scene{.scene = view.scene,
                           .accel = accel,
                           .camera = view.camera,
                           .filter = filter,
                           .estimator = settings_without_roulette(),
                           .width = image_size,
                           .height = image_size,
                           .seed = 0,
                           .first_hits = false,
                           .shapes = ShapeList(view.scene),
                           .few_triangles = {}};
    const std::unique_ptr<BatchTracer> tracer(
        wide_kernels(process_isa()).make_tracer(scene));
    const auto batch = std::make_unique<Batch>();
    const auto work = [&] {
        RayCounts counts;
        for (std::uint32_t y = 0; y < image_size; y += 2) {
            batch->samples = samples;
            batch->pixels = 2 * image_size;
            for (std::uint32_t i = 0; i < 2 * image_size; ++i) {
                batch->x[i] = i % image_size;
                batch->y[i] = y + i / image_size;
            }
            tracer->run(*batch, counts);
            sink = batch->radiance[0][0];
        }
    };
    raykiln_counted_region(work);
}

void count_paths(const View& view) {
    const Accel accel(view.scene);
    const EstimatorSettings settings = settings_without_roulette();
    raykiln_counted_region([&] {
        RayCounts counts;
        for (std::uint32_t i = 0; i < image_size * image_size * samples; ++i) {
            const std::uint32_t x = i / samples % image_size;
            const std::uint32_t y = i / samples / image_size;
            const Context context{view.scene, accel, settings,
                                  sample_key(0, x, y, i % samples), counts};
            const auto u = context.draw(camera_group);
            FirstHit first;
            const Ray ray =
                camera_ray(view.camera, (static_cast<float>(x) + u[0]) / image_size,
                           (static_cast<float>(y) + u[1]) / image_size);
            sink = estimate_path(context, ray, first).x;
        }
    });
}

void add_shading(std::vector<Workload>& list, const std::string& isa,
                 std::span<const ShadingKernel> kernels) {
    for (const ShadingKernel& kernel : kernels) {
        list.push_back(
            {std::string(kernel.name) + "/" + isa, [kernel] { count_shading(kernel); }});
    }
}

void add_rays(std::vector<Workload>& list, const std::string& name, View (*make)()) {
    const auto add = [&](const char* kind, auto trace) {
        list.push_back(
            {"rays/" + name + "/" + kind, [=] { count_rays(make(), 64, trace); }});
    };
    add("primary", [](const Accel& a, const RaySet& r) {
        return trace_packets<8>(a, make_packets<8>(r.primary), true);
    });
    add("bounce",
        [](const Accel& a, const RaySet& r) { return trace_single(a, r.bounce); });
    add("occlusion", [](const Accel& a, const RaySet& r) {
        return occlude_packets<8>(a, make_packets<8>(r.shadow));
    });
}

std::vector<Workload> workloads() {
    std::vector<Workload> list;
    add_shading(list, "float", raykiln_micro_float());
    add_shading(list, "sse4.2", raykiln_micro_sse42());
    if (can_run(Isa::avx2)) {
        add_shading(list, "avx2", raykiln_micro_avx2());
    }
    add_rays(list, "cornell", cornell_box);
    add_rays(list, "ball", [] { return displaced_ball(5); });
    const auto many = [] { return many_lights(1000); };
    list.push_back({"render/cornell/batches", [] { count_batches(cornell_box()); }});
    list.push_back({"render/cornell/paths", [] { count_paths(cornell_box()); }});
    list.push_back({"render/many_lights/batches", [=] { count_batches(many()); }});
    list.push_back({"render/many_lights/paths", [=] { count_paths(many()); }});
    return list;
}

int run(std::string_view wanted) {
    for (const Workload& workload : workloads()) {
        if (wanted == "--list") {
            std::puts(workload.name.c_str());
        } else if (wanted == workload.name) {
            workload.run();
            return 0;
        }
    }
    return wanted == "--list" ? 0 : 2;
}

}  // namespace

}  // namespace raykiln::bench

int main(int count, char** arguments) {
    if (count != 2) {
        std::fputs("usage: raykiln_instructions --list | NAME\n", stderr);
        return 2;
    }
    return raykiln::bench::run(arguments[1]);
}
