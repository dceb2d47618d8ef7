//! Structs and constants that are declared once in Rust and generated for GLSL.
//!
//! Rust uses `repr(C)` without padding (`Pod` rejects padding), GLSL the `scalar` layout. In both, field offsets are
//! running sums of the same sizes. The build script also compiles this file and generates the include `shared.glsl`.

use std::marker::PhantomData;

use bytemuck::{Pod, Zeroable};
use glam::{Mat4, UVec2, UVec4, Vec2, Vec3, Vec4};

/// A type with the same memory layout in GLSL.
pub trait Glsl: Pod {
    /// The type's name in GLSL.
    fn name() -> String;
}

/// Push constants of one kernel.
pub trait Push: Pod {
    /// Its shaders are `glsl/{KERNEL}.*`.
    const KERNEL: &'static str;
    /// The kernel's specialization constants; `()` if it has none.
    type Constants: Constants;
    /// [`Compute`] or [`DrawDepth`].
    type Pipeline;
}

/// [`Push::Pipeline`] of a compute kernel, `glsl/{KERNEL}.comp`.
pub enum Compute {}

/// [`Push::Pipeline`] of shaders that draw depth: `glsl/{KERNEL}.vert`, and `glsl/{KERNEL}.frag` if it exists.
pub enum DrawDepth {}

/// Specialization constants of a kernel. Code that a scene does not use is removed when the pipeline is compiled.
pub trait Constants: Default {
    /// By `constant_id`: GLSL type, GLSL name and value of each constant.
    fn list(&self) -> Vec<(&'static str, String, u32)>;
}

impl Constants for () {
    fn list(&self) -> Vec<(&'static str, String, u32)> {
        Vec::new()
    }
}

macro_rules! primitive {
    ($($rust:ty => $glsl:literal),* $(,)?) => {
        $(impl Glsl for $rust {
            fn name() -> String {
                $glsl.into()
            }
        })*

        /// GLSL declarations of [`Read`], [`Write`] and [`Exchange`] for each primitive.
        pub fn primitive_references() -> String {
            [$(references::<$rust>()),*].concat()
        }
    };
}

primitive! {
    f32 => "float",
    u32 => "uint",
    UVec2 => "uvec2",
    UVec4 => "uvec4",
    Vec2 => "vec2",
    Vec3 => "vec3",
    Vec4 => "vec4",
    Mat4 => "mat4",
}

impl<T: Glsl, const N: usize> Glsl for [T; N] {
    fn name() -> String {
        format!("{}[{N}]", T::name())
    }
}

/// Device address of `[T]` that a pass reads. Only a pass creates one: an address proves that the access was declared.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Read<T>(u64, PhantomData<T>);

/// Device address of `[T]` that a pass writes. A thread may read what earlier passes or it itself wrote.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Write<T>(u64, PhantomData<T>);

/// Device address of `[T]` through which threads of a workgroup pass values to each other, with a `memoryBarrierBuffer`
/// and a `barrier` between write and read. It is coherent: otherwise a thread may read what its own cache holds.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Exchange<T>(u64, PhantomData<T>);

macro_rules! address {
    ($name:ident) => {
        /// Only passes may use this, since they record declared accesses; `tests/architecture.rs` checks it.
        impl<T> From<u64> for $name<T> {
            fn from(address: u64) -> Self {
                Self(address, PhantomData)
            }
        }

        impl<T: Glsl> Glsl for $name<T> {
            fn name() -> String {
                format!(concat!(stringify!($name), "_{}"), T::name())
            }
        }
    };
}
address!(Read);
address!(Write);
address!(Exchange);

/// GLSL declarations of `Read<T>`, `Write<T>` and `Exchange<T>`.
pub fn references<T: Glsl>() -> String {
    // Buffers start at multiples of 16 bytes, so the alignment of an element is the power of two in its size.
    let align = 1 << size_of::<T>().trailing_zeros().min(4);
    let name = T::name();
    [("Read", "readonly "), ("Write", ""), ("Exchange", "coherent ")]
        .map(|(kind, access)| {
            format!(
                "layout(buffer_reference, scalar, buffer_reference_align = {align}) {access}buffer {kind}_{name} {{ \
                 {name} at[]; }};\n"
            )
        })
        .concat()
}

/// Kernel of `P`, and the GLSL of its push constants and specialization constants.
pub fn interface<P: Push + Glsl>() -> (&'static str, String) {
    let mut glsl = format!("layout(push_constant, scalar) uniform Block {{ {} push; }};\n", P::name());
    for (id, (kind, name, value)) in P::Constants::default().list().into_iter().enumerate() {
        glsl += &format!("layout(constant_id = {id}) const {kind} {name} = {kind}({value});\n");
    }
    (P::KERNEL, glsl)
}

/// Declares constants and structs in Rust; `shared_glsl()`, which returns their GLSL; and `interfaces()`, which returns
/// the GLSL that is specific to each kernel, by its name.
///
/// `struct` items can be elements of buffers. `push` items are push constants of the compute kernel named after `for`,
/// `draw` items those of shaders that draw depth. Both must fit into 128 bytes, the smallest limit that Vulkan allows.
/// Eight-byte fields come first. The kernel's struct of
/// specialization constants is given in parentheses. In GLSL their names are in capitals, and the values given here are
/// the defaults.
macro_rules! gpu_shared {
    (
        constants { $($(#[doc = $const_doc:literal])* pub const $constant:ident: u32 = $value:expr;)* }
        floats { $($(#[doc = $float_doc:literal])* pub const $float:ident: f32 = $float_value:expr;)* }
        tables { $($(#[doc = $table_doc:literal])* pub const $table:ident: [u32; $length:expr] = $entries:expr;)* }
        specializations {
            $($(#[doc = $special_doc:literal])* pub struct $special:ident {
                $($(#[doc = $id_doc:literal])* pub $id:ident: $id_type:ident = $default:expr,)*
            })*
        }
        structs {
            $($(#[doc = $doc:literal])* pub $kind:ident $name:ident $(for $kernel:ident $(($constants:ident))?)? {
                $($(#[doc = $field_doc:literal])* pub $field:ident: $type:ty,)*
            })*
        }
    ) => {
        $($(#[doc = $const_doc])* pub const $constant: u32 = $value;)*
        $($(#[doc = $float_doc])* pub const $float: f32 = $float_value;)*
        $($(#[doc = $table_doc])* pub const $table: [u32; $length] = $entries;)*
        $(
            $(#[doc = $special_doc])*
            #[derive(Clone, Copy, Debug)]
            pub struct $special {
                $($(#[doc = $id_doc])* pub $id: $id_type,)*
            }
            impl Default for $special {
                fn default() -> Self {
                    Self { $($id: $default,)* }
                }
            }
            impl $crate::shared::gpu_struct::Constants for $special {
                fn list(&self) -> Vec<(&'static str, String, u32)> {
                    vec![$((
                        gpu_shared!(@glsl $id_type),
                        stringify!($id).to_uppercase(),
                        u32::from(self.$id),
                    ),)*]
                }
            }
        )*
        $(
            $(#[doc = $doc])*
            $(#[doc = concat!("Push constants of `glsl/", stringify!($kernel), "`.")])?
            #[repr(C)]
            #[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
            pub struct $name {
                $($(#[doc = $field_doc])* pub $field: $type,)*
            }
            impl $crate::shared::gpu_struct::Glsl for $name {
                fn name() -> String {
                    stringify!($name).into()
                }
            }
            $(
                impl $crate::shared::gpu_struct::Push for $name {
                    const KERNEL: &'static str = stringify!($kernel);
                    type Constants = gpu_shared!(@constants $($constants)?);
                    type Pipeline = gpu_shared!(@pipeline $kind);
                }
                const _: () = assert!(size_of::<$name>() <= 128, "push constants are limited to 128 bytes");
            )?
        )*

        /// GLSL of all constants and structs declared here.
        pub fn shared_glsl() -> String {
            use $crate::shared::gpu_struct::Glsl;
            let mut glsl = $crate::shared::gpu_struct::primitive_references();
            $(
                $(glsl += &format!("//{}\n", $const_doc);)*
                glsl += &format!("const uint {} = {}u;\n", stringify!($constant), $constant);
            )*
            $(
                $(glsl += &format!("//{}\n", $float_doc);)*
                glsl += &format!("const float {} = {:?};\n", stringify!($float), $float);
            )*
            $(
                $(glsl += &format!("//{}\n", $table_doc);)*
                let entries = $table.map(|entry| format!("{entry}u")).join(", ");
                glsl += &format!("const uint {0}[{1}] = uint[{1}]({entries});\n", stringify!($table), $table.len());
            )*
            $(
                $(glsl += &format!("//{}\n", $doc);)*
                glsl += concat!("struct ", stringify!($name), " {\n");
                $(
                    $(glsl += &format!("    //{}\n", $field_doc);)*
                    glsl += &format!("    {} {};\n", <$type as Glsl>::name(), stringify!($field));
                )*
                glsl += "};\n";
                glsl += gpu_shared!(@references $kind $name);
            )*
            glsl
        }

        /// Kernel names, with the GLSL of their push constants and specialization constants.
        pub fn interfaces() -> Vec<(&'static str, String)> {
            vec![$($(gpu_shared!(@interface $name $kernel),)?)*]
        }
    };
    (@references struct $name:ident) => {
        &$crate::shared::gpu_struct::references::<$name>()
    };
    (@references push $name:ident) => {
        "" // declared only in its kernel, see `interface`
    };
    (@references draw $name:ident) => {
        ""
    };
    (@pipeline push) => {
        $crate::shared::gpu_struct::Compute
    };
    (@pipeline draw) => {
        $crate::shared::gpu_struct::DrawDepth
    };
    (@glsl bool) => {
        "bool"
    };
    (@glsl u32) => {
        "uint"
    };
    (@constants) => {
        ()
    };
    (@constants $constants:ident) => {
        $constants
    };
    (@interface $name:ident $kernel:ident) => {
        $crate::shared::gpu_struct::interface::<$name>()
    };
}
pub(crate) use gpu_shared;
