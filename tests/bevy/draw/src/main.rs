//! Draw the vertices of characters as points, without a window: into each pixel the normal and the number of its vertex.
//!
//! Usage: draw SCENE.json, where `scene` below says what the file holds. On stdout a line of JSON for each mesh.

use bevy::{
    app::PluginsState,
    asset::{AssetEvent, UnapprovedPathMode},
    camera::{RenderTarget, ScalingMode},
    core_pipeline::{
        prepass::{DeferredPrepass, DepthPrepass, NormalPrepass},
        tonemapping::Tonemapping,
    },
    gltf::GltfAssetLabel,
    mesh::{PrimitiveTopology, morph::MorphWeights},
    pbr::DefaultOpaqueRendererMethod,
    prelude::*,
    render::{
        gpu_readback::{Readback, ReadbackComplete},
        render_resource::{TextureFormat, TextureUsages},
    },
    shader::Shader,
    window::{ExitCondition, WindowPlugin},
};
use serde_json::{Value, json};
use skinbake_bevy::{SkinbakeMaterial, SkinbakeMesh, SkinbakePlugin};

/// In place of StandardMaterial's fragment stage in the forward pass. NORMAL is what it writes.
const FORWARD: &str = "
#ifdef PREPASS_PIPELINE
#import bevy_pbr::prepass_io::{VertexOutput, FragmentOutput}
#import bevy_pbr::pbr_fragment::pbr_input_from_standard_material
#import bevy_pbr::pbr_deferred_functions::deferred_output
#else
#import bevy_pbr::forward_io::{VertexOutput, FragmentOutput}
#endif
#ifdef NORMAL_PREPASS
#import bevy_pbr::prepass_utils::prepass_normal
#endif
@fragment
fn fragment(in: VertexOutput, @builtin(front_facing) is_front: bool) -> FragmentOutput {
    var out: FragmentOutput;
#ifdef PREPASS_PIPELINE
    out = deferred_output(in, pbr_input_from_standard_material(in, true));
#else
    out.color = vec4<f32>(NORMAL, in.uv.x);
#endif
    return out;
}
";
/// In place of the lighting of deferred rendering.
const DEFERRED: &str = "
#import bevy_pbr::mesh_view_bindings::deferred_prepass_texture
#import bevy_pbr::pbr_deferred_functions::pbr_input_from_deferred_gbuffer
struct Varying {
    @builtin(position) position: vec4<f32>,
    @location(0) uv: vec2<f32>,
}
@group(2) @binding(0) var<uniform> depth_id: u32;
@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Varying {
    let uv = vec2<f32>(f32(index >> 1u), f32(index & 1u)) * 2.0;
    return Varying(vec4<f32>(uv * vec2<f32>(2.0, -2.0) + vec2<f32>(-1.0, 1.0), f32(depth_id) / 255.0, 1.0), uv);
}
@fragment
fn fragment(in: Varying) -> @location(0) vec4<f32> {
    let stored = textureLoad(deferred_prepass_texture, vec2<i32>(in.position.xy), 0);
    return vec4<f32>(pbr_input_from_deferred_gbuffer(vec4<f32>(in.position.xy, 0.0, 0.0), stored).N, 1.0);
}
";

#[derive(Resource)]
struct Scene(Value);

#[derive(Resource)]
struct Texts(Vec<(&'static str, String)>);

#[derive(Resource, Default)]
struct Drawn(Vec<u8>);

#[derive(Resource)]
struct Clips(Vec<(Handle<AnimationGraph>, AnimationNodeIndex)>);

fn main() {
    let path = std::env::args().nth(1).expect("usage: draw SCENE.json");
    let scene: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let mode = scene["mode"].as_str().unwrap().to_string();
    let mut app = App::new();
    app.add_plugins(
        DefaultPlugins
            .set(AssetPlugin {
                file_path: scene["folder"].as_str().unwrap().into(),
                unapproved_path_mode: UnapprovedPathMode::Allow,
                ..default()
            })
            .set(WindowPlugin { primary_window: None, exit_condition: ExitCondition::DontExit, ..default() }),
    );
    let normal = if mode == "prepass" { "prepass_normal(in.position, 0u)" } else { "in.world_normal" };
    let mut texts = vec![("bevy_pbr/render/pbr.wgsl", FORWARD.replace("NORMAL,", &format!("{normal},")))];
    if mode == "deferred" {
        texts.push(("bevy_pbr/deferred/deferred_lighting.wgsl", DEFERRED.into()));
        app.insert_resource(DefaultOpaqueRendererMethod::deferred());
    }
    // Bevy's feature reflect_auto_register does this for applications.
    app.register_type::<Transform>()
        .register_type::<GlobalTransform>()
        .register_type::<bevy::transform::components::TransformTreeChanged>()
        .register_type::<Visibility>()
        .register_type::<InheritedVisibility>()
        .register_type::<ViewVisibility>()
        .register_type::<bevy::camera::visibility::VisibilityClass>()
        .register_type::<bevy::camera::visibility::DynamicSkinnedMeshBounds>()
        .register_type::<bevy::camera::primitives::Aabb>()
        .register_type::<Name>()
        .register_type::<ChildOf>()
        .register_type::<Children>()
        .register_type::<Mesh3d>()
        .register_type::<MeshMaterial3d<StandardMaterial>>()
        .register_type::<bevy::mesh::skinning::SkinnedMesh>()
        .register_type::<MorphWeights>()
        .register_type::<bevy::mesh::morph::MeshMorphWeights>()
        .register_type::<AnimationPlayer>()
        .register_type::<bevy::animation::AnimationTargetId>()
        .register_type::<bevy::animation::AnimatedBy>()
        .register_type::<bevy::gltf::GltfExtras>()
        .register_type::<bevy::gltf::GltfSceneExtras>()
        .register_type::<bevy::gltf::GltfSceneName>()
        .register_type::<bevy::gltf::GltfMeshExtras>()
        .register_type::<bevy::gltf::GltfMeshName>()
        .register_type::<bevy::gltf::GltfMaterialExtras>()
        .register_type::<bevy::gltf::GltfMaterialName>();
    app.add_plugins(SkinbakePlugin)
        .insert_resource(ClearColor(Color::linear_rgba(0.0, 0.0, 0.0, 0.0)))
        .insert_resource(Scene(scene))
        .insert_resource(Texts(texts))
        .init_resource::<Drawn>()
        .add_systems(Startup, set_up)
        .add_systems(First, (to_points, replace))
        .add_systems(Update, pose)
        .add_observer(|complete: On<ReadbackComplete>, mut drawn: ResMut<Drawn>| drawn.0 = complete.data.clone());
    while app.plugins_state() == PluginsState::Adding {
        bevy::tasks::tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();

    let count = app.world().resource::<Scene>().0["instances"].as_array().unwrap().len();
    let mut last = Vec::new();
    let mut alike = 0;
    for _ in 0..3000 {
        app.update();
        let drawn = &app.world().resource::<Drawn>().0;
        alike = if *drawn == last && drawn.iter().any(|&byte| byte != 0) { alike + 1 } else { 0 };
        last = drawn.clone();
        let loaded = app.world_mut().query::<&SkinbakeMesh>().iter(app.world()).count() >= count;
        if loaded && alike >= 10 {
            finish(&mut app, &last);
            return;
        }
    }
    panic!("the picture does not come to rest");
}

/// Replace shaders of Bevy's own once they are loaded.
fn replace(mut events: MessageReader<AssetEvent<Shader>>, mut shaders: ResMut<Assets<Shader>>, texts: Res<Texts>) {
    for event in events.read() {
        let AssetEvent::Added { id } = event else { continue };
        let path = shaders.get(*id).unwrap().path.clone();
        if let Some((_, text)) = texts.0.iter().find(|(name, _)| path.ends_with(name)) {
            _ = shaders.insert(*id, Shader::from_wgsl(text.clone(), path));
        }
    }
}

fn set_up(
    mut commands: Commands,
    scene: Res<Scene>,
    assets: Res<AssetServer>,
    mut images: ResMut<Assets<Image>>,
    mut graphs: ResMut<Assets<AnimationGraph>>,
) {
    let scene = &scene.0;
    let number = |value: &Value| value.as_f64().unwrap() as f32;
    let vector = |value: &Value| Vec3::new(number(&value[0]), number(&value[1]), number(&value[2]));
    let [width, height] = ["width", "height"].map(|name| number(&scene[name]));
    let mut image = Image::new_target_texture(width as u32, height as u32, TextureFormat::Rgba32Float, None);
    image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
    let image = images.add(image);
    let tall = number(&scene["tall"]);
    let mut camera = commands.spawn((
        Camera3d::default(),
        Camera::default(),
        RenderTarget::Image(image.clone().into()),
        Tonemapping::None,
        Msaa::Off,
        Projection::Orthographic(OrthographicProjection {
            scaling_mode: ScalingMode::Fixed { width: tall * width / height, height: tall },
            near: 0.0,
            far: 200.0,
            ..OrthographicProjection::default_3d()
        }),
        Transform::from_xyz(0.0, 0.0, 100.0),
    ));
    match scene["mode"].as_str().unwrap() {
        "prepass" => _ = camera.insert((DepthPrepass, NormalPrepass)),
        "deferred" => _ = camera.insert((DepthPrepass, DeferredPrepass)),
        _ => {}
    }
    commands.spawn(Readback::texture(image));
    let mut clips = Vec::new();
    for instance in scene["instances"].as_array().unwrap() {
        let file = instance["file"].as_str().unwrap().to_string();
        let root = assets.load(GltfAssetLabel::Scene(0).from_asset(file.clone()));
        let place = Transform::from_translation(vector(&instance["at"])).with_scale(vector(&instance["scale"]));
        commands.spawn((WorldAssetRoot(root), place, Name::new(file.clone())));
        let clip = assets.load(GltfAssetLabel::Animation(0).from_asset(file));
        let (graph, node) = AnimationGraph::from_clip(clip);
        clips.push((graphs.add(graph), node));
    }
    commands.insert_resource(Clips(clips));
}

/// Draw vertices in place of triangles.
fn to_points(mut events: MessageReader<AssetEvent<Mesh>>, mut meshes: ResMut<Assets<Mesh>>) {
    for event in events.read() {
        let AssetEvent::Added { id } = event else { continue };
        let mesh = meshes.get(*id).unwrap();
        if mesh.primitive_topology() == PrimitiveTopology::PointList {
            continue;
        }
        let mut points = Mesh::new(PrimitiveTopology::PointList, mesh.asset_usage);
        for (kind, values) in mesh.attributes() {
            points.insert_attribute(*kind, values.clone());
        }
        if mesh.has_morph_targets() {
            points.set_morph_targets(mesh.morph_targets().unwrap().clone());
        }
        _ = meshes.insert(*id, points);
    }
}

/// Hold each character in the pose of the scene.
fn pose(
    mut commands: Commands,
    scene: Res<Scene>,
    clips: Res<Clips>,
    mut players: Query<(Entity, &mut AnimationPlayer), Without<AnimationGraphHandle>>,
    mut morphs: Query<&mut MorphWeights>,
    parents: Query<&ChildOf>,
    names: Query<&Name, With<WorldAssetRoot>>,
) {
    for (entity, mut player) in &mut players {
        let root = parents.iter_ancestors(entity).find_map(|above| names.get(above).ok()).unwrap();
        let instances = scene.0["instances"].as_array().unwrap();
        let number = instances.iter().position(|one| one["file"].as_str() == Some(root.as_str())).unwrap();
        let (graph, node) = &clips.0[number];
        player.play(*node).seek_to(instances[number]["time"].as_f64().unwrap() as f32).pause();
        commands.entity(entity).insert(AnimationGraphHandle(graph.clone()));
    }
    for mut weights in &mut morphs {
        for (weight, given) in weights.weights_mut().iter_mut().zip(scene.0["weights"].as_array().unwrap()) {
            *weight = given.as_f64().unwrap() as f32;
        }
    }
}

fn finish(app: &mut App, drawn: &[u8]) {
    let world = app.world_mut();
    std::fs::write(world.resource::<Scene>().0["out"].as_str().unwrap(), drawn).unwrap();
    let mut meshes = world.query::<(NameOrEntity, &SkinbakeMesh, Option<&MeshMaterial3d<SkinbakeMaterial>>)>();
    for (name, mesh, material) in meshes.iter(world) {
        let material = material.map(|handle| format!("{:?}", handle.id()));
        let name = name.name.map(|name| name.to_string());
        println!("{}", json!({"name": name, "standard": mesh.standard, "material": material}));
    }
}
