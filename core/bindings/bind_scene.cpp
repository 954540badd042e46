// Scenes: raykiln/compile.py describes one part by part, with arrays that are shared, not
// copied.
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>

#include "accel/accel.h"
#include "bind.h"
#include "bsdf/bsdf.h"
#include "compiled_scene.h"
#include "error.h"
#include "isa/isa.h"
#include "light/light.h"

namespace py = pybind11;

namespace raykiln {

namespace {

template <class T>
using Array = py::array_t<T, py::array::c_style>;
using Rgb = std::tuple<float, float, float>;
using ColorTuple = std::tuple<Rgb, int, std::string>;  // factor, texture, channel
using FloatTuple = std::tuple<float, int, std::string>;

Vec3f vec3(const Rgb& v) {
    return {std::get<0>(v), std::get<1>(v), std::get<2>(v)};
}

Channel channel_of(const std::string& name) {
    return name == "r"   ? Channel::r
           : name == "g" ? Channel::g
           : name == "b" ? Channel::b
           : name == "a" ? Channel::a
                         : Channel::rgb;
}
ColorSlot color_slot(const py::dict& d, const char* key) {
    const auto t = d[key].cast<ColorTuple>();
    return {vec3(std::get<0>(t)), std::get<1>(t), channel_of(std::get<2>(t))};
}
FloatSlot float_slot(const py::dict& d, const char* key) {
    const auto t = d[key].cast<FloatTuple>();
    return {std::get<0>(t), std::get<1>(t), channel_of(std::get<2>(t))};
}
MicrofacetSlots surface_slots(const py::dict& d) {
    return {float_slot(d, "alpha_u"), float_slot(d, "alpha_v"),
            d["beckmann"].cast<bool>()};
}
template <class T>
T number(const py::dict& d, const char* key) {
    return d[key].cast<T>();
}

/// Keeps a Python object alive for the core, which lets go of it on any thread.
std::shared_ptr<const void> keep(const py::object& object) {
    PyObject* raw = object.inc_ref().ptr();
    return {raw, [](const void* p) {
                py::gil_scoped_acquire gil;
                Py_DECREF(static_cast<PyObject*>(const_cast<void*>(p)));
            }};
}

/// The array's own memory if reading 4 bytes past its end cannot leave its page, else a
/// copy.
const float* padded(const Array<float>& array,
                    std::vector<std::shared_ptr<const void>>& owners) {
    constexpr std::uintptr_t page = 4096;
    const auto end = reinterpret_cast<std::uintptr_t>(array.data()) +
                     static_cast<std::uintptr_t>(array.nbytes());
    if (end % page != 0 && end % page <= page - sizeof(float)) {
        owners.push_back(keep(array));
        return array.data();
    }
    auto copy =
        std::make_shared<std::vector<float>>(static_cast<std::size_t>(array.size()) + 1);
    std::memcpy(copy->data(), array.data(), static_cast<std::size_t>(array.nbytes()));
    owners.push_back(copy);
    return copy->data();
}

UvTransform uv_transform(const py::object& rows) {
    if (rows.is_none()) {
        return {};
    }
    const auto m = rows.cast<std::array<std::array<float, 3>, 2>>();
    return {m[0][0], m[0][1], m[0][2], m[1][0], m[1][1], m[1][2]};
}

TextureWrap wrap_of(const std::string& name) {
    return name == "clamp"    ? TextureWrap::clamp
           : name == "mirror" ? TextureWrap::mirror
                              : TextureWrap::repeat;
}

int add_image_texture(CompiledScene& s, const py::array& pixels, bool srgb,
                      const std::string& filter, const std::string& wrap_u,
                      const std::string& wrap_v, const py::object& transform) {
    if (pixels.ndim() != 3 || pixels.shape(2) < 1 || pixels.shape(2) > 4 ||
        pixels.size() == 0 || (pixels.flags() & py::array::c_style) == 0) {
        throw SceneError("a texture takes a C-contiguous array (height, width, 1..4)");
    }
    ImageTexture t;
    t.pixels = pixels.data();
    t.owner = keep(pixels);
    t.height = static_cast<int>(pixels.shape(0));
    t.width = static_cast<int>(pixels.shape(1));
    t.channels = static_cast<int>(pixels.shape(2));
    if (py::isinstance<py::array_t<std::uint8_t>>(pixels)) {
        t.format = PixelFormat::u8;
    } else if (py::isinstance<py::array_t<std::uint16_t>>(pixels)) {
        t.format = PixelFormat::u16;
    } else if (py::isinstance<py::array_t<float>>(pixels)) {
        t.format = PixelFormat::f32;
    } else {
        throw SceneError("a texture takes uint8, uint16 or float32 pixels");
    }
    t.srgb = srgb;
    t.filter = filter == "nearest" ? TextureFilter::nearest : TextureFilter::bilinear;
    t.wrap_u = wrap_of(wrap_u);
    t.wrap_v = wrap_of(wrap_v);
    t.uv_transform = uv_transform(transform);
    s.scene.textures.emplace_back(std::move(t));
    return static_cast<int>(s.scene.textures.size()) - 1;
}

int add_checker_texture(CompiledScene& s, const Rgb& color0, const Rgb& color1,
                        const py::object& transform) {
    s.scene.textures.emplace_back(
        CheckerTexture{vec3(color0), vec3(color1), uv_transform(transform)});
    return static_cast<int>(s.scene.textures.size()) - 1;
}

MaterialKind material_kind(const std::string& kind, const py::dict& d) {
    if (kind == "diffuse") {
        return DiffuseMaterial{color_slot(d, "reflectance")};
    }
    if (kind == "conductor") {
        return ConductorMaterial{vec3(number<Rgb>(d, "eta")), vec3(number<Rgb>(d, "k")),
                                 color_slot(d, "reflectance"), surface_slots(d)};
    }
    if (kind == "dielectric") {
        return DielectricMaterial{number<float>(d, "eta"), color_slot(d, "reflectance"),
                                  color_slot(d, "transmittance"), surface_slots(d),
                                  number<bool>(d, "thin")};
    }
    if (kind == "plastic") {
        PlasticMaterial m{number<float>(d, "eta"),      color_slot(d, "diffuse"),
                          color_slot(d, "specular"),    surface_slots(d),
                          number<bool>(d, "nonlinear"), {}};
        m.table =
            make_interface_table(m.eta, m.surface.alpha_u.factor, m.surface.beckmann);
        return m;
    }
    if (kind == "principled") {
        return PrincipledMaterial{
            color_slot(d, "base_color"), color_slot(d, "specular_color"),
            float_slot(d, "metallic"),   float_slot(d, "roughness"),
            float_slot(d, "specular"),   float_slot(d, "transmission"),
            number<float>(d, "ior")};
    }
    throw SceneError("unknown material kind " + kind);
}

int add_material(CompiledScene& s, const std::string& kind, const py::dict& d) {
    Material m{material_kind(kind, d),       number<bool>(d, "two_sided"),
               number<int>(d, "normal_map"), number<float>(d, "normal_scale"),
               float_slot(d, "opacity"),     number<float>(d, "alpha_cutoff")};
    s.scene.has_opacity = s.scene.has_opacity || m.has_opacity();
    s.scene.materials.push_back(std::move(m));
    return static_cast<int>(s.scene.materials.size()) - 1;
}

std::uint32_t add_emission(CompiledScene& s, const py::object& emission) {
    if (emission.is_none()) {
        return no_index;
    }
    const auto d = emission.cast<py::dict>();
    s.scene.emissions.push_back(
        {color_slot(d, "radiance"), number<bool>(d, "two_sided")});
    return static_cast<std::uint32_t>(s.scene.emissions.size()) - 1;
}

void add_mesh(CompiledScene& s, std::uint32_t group, const Array<float>& vertices,
              const Array<std::uint32_t>& faces, const py::object& normals,
              const py::object& uvs, std::uint32_t material, const py::object& emission,
              bool flip_normals) {
    Mesh mesh;
    mesh.vertex_count = static_cast<std::uint32_t>(vertices.shape(0));
    mesh.triangle_count = static_cast<std::uint32_t>(faces.shape(0));
    mesh.positions = padded(vertices, mesh.owners);
    mesh.indices = faces.data();
    mesh.owners.push_back(keep(faces));
    if (!normals.is_none()) {
        mesh.normals = normals.cast<Array<float>>().data();
        mesh.owners.push_back(keep(normals));
    }
    if (!uvs.is_none()) {
        mesh.uvs = uvs.cast<Array<float>>().data();
        mesh.owners.push_back(keep(uvs));
    }
    mesh.material = material;
    mesh.emission = add_emission(s, emission);
    mesh.flip_normals = flip_normals;
    s.scene.groups.at(group).meshes.push_back(std::move(mesh));
}

void add_sphere(CompiledScene& s, std::uint32_t group, const Rgb& center, float radius,
                std::uint32_t material, const py::object& emission, bool flip_normals) {
    s.scene.groups.at(group).spheres.push_back(
        {vec3(center), radius, material, add_emission(s, emission), flip_normals});
}

void add_instances(CompiledScene& s, std::uint32_t group, const Array<float>& matrices) {
    for (py::ssize_t i = 0; i < matrices.shape(0); ++i) {
        const Transform m = transform_of_rows(matrices.data(i, 0, 0));
        s.scene.instances.push_back({group, m, inverse_linear(m)});
    }
}

void add_environment(CompiledScene& s, const Rgb& scale, int map,
                     const std::array<Rgb, 3>& columns) {
    EnvironmentLight light;
    light.scale = vec3(scale);
    light.map = map;
    light.world_from_light = {vec3(columns[0]), vec3(columns[1]), vec3(columns[2])};
    s.scene.lights.emplace_back(std::move(light));
}

void add_camera(CompiledScene& s, const Array<float>& world_from_camera, float tan_half_x,
                float tan_half_y, float offset_x, float offset_y, float near, float far) {
    const Transform m = transform_of_rows(world_from_camera.data());
    s.camera = {m.origin,   {normalize(m.x), normalize(m.y), normalize(m.z)},
                tan_half_x, tan_half_y,
                offset_x,   offset_y,
                near,       far};
}

py::dict summary(const CompiledScene& s) {
    py::dict d;
    d["triangles"] = s.scene.triangle_count();
    d["spheres"] = s.scene.sphere_count();
    d["instances"] = s.scene.instances.size();
    d["lights"] = s.scene.lights.size();
    d["materials"] = s.scene.materials.size();
    d["textures"] = s.scene.textures.size();
    return d;
}

}  // namespace

void bind_scene(py::module_& m) {
    m.def("isa", [] { return isa_name(process_isa()); });
    py::class_<CompiledScene, std::shared_ptr<CompiledScene>>(m, "Scene")
        .def(py::init<>())
        .def("add_image_texture", &add_image_texture, py::arg("pixels"), py::kw_only(),
             py::arg("srgb"), py::arg("filter"), py::arg("wrap_u"), py::arg("wrap_v"),
             py::arg("uv_transform"))
        .def("add_checker_texture", &add_checker_texture, py::arg("color0"),
             py::arg("color1"), py::arg("uv_transform"))
        .def("add_material", &add_material, py::arg("kind"), py::arg("parameters"))
        .def("add_group",
             [](CompiledScene& s) {
                 s.scene.groups.emplace_back();
                 return s.scene.groups.size() - 1;
             })
        .def("add_mesh", &add_mesh, py::arg("group"), py::arg("vertices").noconvert(),
             py::arg("faces").noconvert(), py::arg("normals"), py::arg("uvs"),
             py::arg("material"), py::arg("emission"), py::arg("flip_normals"))
        .def("add_sphere", &add_sphere, py::arg("group"), py::arg("center"),
             py::arg("radius"), py::arg("material"), py::arg("emission"),
             py::arg("flip_normals"))
        .def("add_instances", &add_instances, py::arg("group"),
             py::arg("matrices").noconvert())
        .def("add_point_light",
             [](CompiledScene& s, const Rgb& position, const Rgb& intensity) {
                 s.scene.lights.emplace_back(PointLight{vec3(position), vec3(intensity)});
             })
        .def("add_spot_light",
             [](CompiledScene& s, const Rgb& position, const Rgb& axis,
                const Rgb& intensity, float cos_inner, float cos_outer) {
                 s.scene.lights.emplace_back(
                     SpotLight{vec3(position), normalize(vec3(axis)), vec3(intensity),
                               cos_inner, cos_outer});
             })
        .def("add_directional_light",
             [](CompiledScene& s, const Rgb& direction, const Rgb& irradiance) {
                 s.scene.lights.emplace_back(
                     DirectionalLight{normalize(vec3(direction)), vec3(irradiance)});
             })
        .def("add_environment_light", &add_environment, py::arg("scale"), py::arg("map"),
             py::arg("columns"))
        .def("set_camera", &add_camera, py::arg("world_from_camera"),
             py::arg("tan_half_x"), py::arg("tan_half_y"), py::arg("offset_x"),
             py::arg("offset_y"), py::arg("near"), py::arg("far"))
        .def("build", &CompiledScene::build, py::call_guard<py::gil_scoped_release>())
        .def("summary", &summary)
        .def("bounds",
             [](const CompiledScene& s) {
                 const Bounds& b = s.scene.bounds;
                 return std::make_pair(Rgb{b.low.x, b.low.y, b.low.z},
                                       Rgb{b.high.x, b.high.y, b.high.z});
             })
        .def_property_readonly("memory_bytes", [](const CompiledScene& s) {
            return s.accel ? s.accel->memory_bytes() : 0;
        });
}

}  // namespace raykiln
