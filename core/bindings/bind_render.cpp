// Rendering: passes run with the GIL released; it is taken for a moment at each poll.
#include <initializer_list>
#include <string>
#include <utility>

#include "bind.h"
#include "compiled_scene.h"
#include "error.h"
#include "render/renderer.h"

namespace py = pybind11;

namespace raykiln {

namespace {

/// What an option's name stands for; throws SettingsError for a name that is not known.
template <class T>
T named(const py::dict& options, const char* option,
        std::initializer_list<std::pair<const char*, T>> known) {
    const auto name = options[option].cast<std::string>();
    std::string accepted;
    for (const auto& [accepted_name, value] : known) {
        if (name == accepted_name) {
            return value;
        }
        accepted += accepted.empty() ? "" : ", ";
        accepted += accepted_name;
    }
    throw SettingsError(std::string(option) + ": there is none of this name (found \"" +
                        name + "\", accepted: " + accepted + ")");
}

RenderOptions options_of(const py::dict& d) {
    RenderOptions o;
    o.width = d["width"].cast<int>();
    o.height = d["height"].cast<int>();
    const auto crop = d["crop"].cast<std::array<int, 4>>();
    o.crop_x0 = crop[0];
    o.crop_y0 = crop[1];
    o.crop_x1 = crop[2];
    o.crop_y1 = crop[3];
    o.spp = d["spp"].cast<std::uint32_t>();
    o.seed = d["seed"].cast<std::uint32_t>();
    o.threads = d["threads"].cast<int>();
    o.filter = named<FilterKind>(d, "filter",
                                 {{"box", FilterKind::box},
                                  {"tent", FilterKind::tent},
                                  {"gaussian", FilterKind::gaussian},
                                  {"blackman_harris", FilterKind::blackman_harris}});
    o.layers = {d["albedo"].cast<bool>(), d["normal"].cast<bool>(),
                d["depth"].cast<bool>()};
    o.estimator.integrator = named<IntegratorKind>(d, "integrator",
                                                   {{"path", IntegratorKind::path},
                                                    {"whitted", IntegratorKind::whitted},
                                                    {"direct", IntegratorKind::direct},
                                                    {"ao", IntegratorKind::ao}});
    o.estimator.sampler = named<SamplerKind>(
        d, "sampler",
        {{"sobol", SamplerKind::sobol}, {"independent", SamplerKind::independent}});
    if (d.contains("strategy")) {
        o.estimator.strategy = named<Strategy>(d, "strategy",
                                               {{"mis", Strategy::mis},
                                                {"light", Strategy::light_only},
                                                {"bsdf", Strategy::bsdf_only}});
    }
    o.reference = d.contains("reference") && d["reference"].cast<bool>();
    o.few_triangles = !d.contains("few_triangles") || d["few_triangles"].cast<bool>();
    o.caustic_guide = !d.contains("caustic_guide") || d["caustic_guide"].cast<bool>();
    const int max_depth = d["max_depth"].cast<int>();
    o.estimator.max_depth = max_depth < 0 ? 1 << 30 : max_depth;
    o.estimator.rr_depth = d["rr_depth"].cast<int>();
    return o;
}

/// A renderer that keeps its scene alive.
struct PyRenderer {
    std::shared_ptr<CompiledScene> scene;
    Renderer renderer;

    PyRenderer(std::shared_ptr<CompiledScene> s, const py::dict& options) :
        scene(std::move(s)),
        renderer(scene->scene, built(*scene), scene->camera, options_of(options)) {}

    static const Accel& built(const CompiledScene& s) {
        if (!s.accel) {
            throw RenderError("the scene is not built yet");
        }
        return *s.accel;
    }
};

/// A view of a film plane as (height, width[, 3]); it keeps the renderer alive.
template <class T>
py::array plane(py::object& self, std::vector<T>& values, bool three) {
    Film& film = self.cast<PyRenderer&>().renderer.film();
    if (values.empty()) {
        return py::array_t<T>(0);
    }
    std::vector<py::ssize_t> shape{film.height(), film.width()};
    if (three) {
        shape.push_back(3);
    }
    return py::array_t<T>(shape, values.data(), self);
}

/// The sums of the film by name, shared with it: read them for an image, fill them to
/// resume.
py::dict planes(py::object self) {
    Film& film = self.cast<PyRenderer&>().renderer.film();
    py::dict d;
    d["radiance"] = plane(self, film.radiance(), true);
    d["luminance_squared"] = plane(self, film.luminance_squared(), false);
    d["counts"] = plane(self, film.counts(), false);
    if (film.layers().albedo) {
        d["albedo"] = plane(self, film.albedo(), true);
    }
    if (film.layers().normal) {
        d["normal"] = plane(self, film.normal(), true);
    }
    if (film.layers().depth) {
        d["depth"] = plane(self, film.depth(), false);
        d["depth_weight"] = plane(self, film.depth_weight(), false);
    }
    return d;
}

bool run_pass(PyRenderer& r, const py::object& poll) {
    py::gil_scoped_release release;
    return r.renderer.run_pass([&](std::uint64_t samples) {
        py::gil_scoped_acquire acquire;
        if (PyErr_CheckSignals() != 0) {
            throw py::error_already_set();
        }
        return poll(samples).cast<bool>();
    });
}

py::dict counts_of(const PyRenderer& r) {
    const RayCounts& c = r.renderer.counts();
    py::dict d;
    d["camera_rays"] = c.camera;
    d["bounce_rays"] = c.bounce;
    d["shadow_rays"] = c.shadow;
    d["nonfinite_samples"] = c.nonfinite;
    return d;
}

}  // namespace

void bind_render(py::module_& m) {
    py::class_<PyRenderer>(m, "Renderer")
        .def(py::init<std::shared_ptr<CompiledScene>, const py::dict&>(),
             py::arg("scene"), py::arg("options"))
        .def("run_pass", &run_pass, py::arg("poll"))
        .def("planes", &planes)
        .def("resume", [](PyRenderer& r) { r.renderer.resume(); })
        .def("counts", &counts_of)
        .def_property_readonly(
            "samples_done", [](const PyRenderer& r) { return r.renderer.samples_done(); })
        .def_property_readonly("finished",
                               [](const PyRenderer& r) { return r.renderer.finished(); })
        .def_property_readonly("threads",
                               [](const PyRenderer& r) { return r.renderer.threads(); });
}

}  // namespace raykiln
