//! relume: interactive relighting of scenes with fixed camera, geometry and materials.
//!
//! With those fixed, which surface each pixel sees, also through mirrors, is known once and for all: the layered deep
//! framebuffer. When a light moves, its view samples are shaded again. When only its colour changes, the cached images
//! of the lights are summed again.
//!
//! Data flows one way, and no arrow points back (`tests/architecture.rs` has the table):
//!
//! ```text
//! scene -> bake -> relight, final_gather -> session -> view, the command line
//!   physics, storage and gpu lie below and use none of them; trace uses scene and physics only
//! ```
//!
//! - [`scene`]: files in, plain data out. World space is in double precision.
//! - [`bake`]: [`scene::Scene`] -> [`bake::DeepFramebuffer`], what does not depend on the lights: view samples,
//!   transfer, its compression.
//! - [`relight`]: visibility, shading, sums of light images, the picture.
//! - [`session`]: from a scene's file to a relighter: settings, plan, cache, bake.
//! - [`final_gather`]: indirect light gathered anew for known lights, better with each pass.
//! - [`desk`]: the lighting desk without a window: edits of the lights, groups, snapshots, undo.
//! - [`wire`]: other programs read and edit the lights, one JSON object a line.
//! - [`view`]: the window and its keys.
//! - [`physics`]: glTF's BRDF, punctual lights, sampling sequences, directions: pure functions.
//! - [`trace`]: BVH, packets of shadow rays, the surface at a hit.
//! - [`storage`]: mapped files, journals, files that are whole or not there.
//! - [`gpu`]: device, memory, kernels, frames. Knows no lights.
//! - [`shared`]: the structs that Rust and the kernels in `glsl/` have in common, declared once.
//! - [`image`]: EXR and PNG, and how pictures differ.
//! - [`report`]: a page of what was measured, errors against run time above all.
//! - [`mod@reference`]: the kernels again in double precision on the CPU, to test them against, and a path tracer: the
//!   reference that errors are measured against.
//!
//! ```no_run
//! use std::path::Path;
//! use relume::relight::{Picture, RelightSettings};
//! use relume::{Session, SessionSettings};
//!
//! # fn main() -> relume::Result<()> {
//! // Baked with all indirect light, or found in the cache. `()` hears nothing of progress.
//! let session = Session::open(Path::new("scenes/balls-2.glb"), None, &SessionSettings::default(), &())?;
//! let context = session.context(None)?;
//! let mut relighter = session.relighter(&context, &session.rig, &RelightSettings::default())?;
//! let mut rig = session.rig.clone();
//! rig.lights[0].position.y += 0.1;
//! relighter.set_rig(&rig)?;
//! let pixels: &[[u8; 4]] = relighter.display(Picture::Whole)?;
//! # Ok(()) }
//! ```
//!
//! # Bibliography
//!
//! - [Ahmed 2020] Ahmed, Wonka, Screen-space blue-noise diffusion of Monte Carlo sampling error via hierarchical
//!   ordering of pixels, ACM TOG 39(6).
//! - [Andersson 2020] Andersson et al., FLIP: a difference evaluator for alternating images, Proc. ACM CGIT 3(2).
//! - [Appleby 2011] Appleby, MurmurHash3, public domain.
//! - [Atanasov 2018] Atanasov et al., Adaptive environment sampling on CPU and GPU, SIGGRAPH Talks.
//! - [Binder 2019] Binder, Fricke, Keller, Massively parallel path space filtering, arXiv 1902.05942.
//! - [Burley 2020] Burley, Practical hash-based Owen scrambling, JCGT 9(4).
//! - [Christensen 2003] Christensen, Adjoints and importance in rendering: an overview, IEEE TVCG 9(3).
//! - [Cigolle 2014] Cigolle et al., A survey of efficient representations for independent unit vectors, JCGT 3(2).
//! - [Clarberg 2008] Clarberg, Fast equal-area mapping of the (hemi)sphere using SIMD, Journal of Graphics Tools 13(3).
//! - [Croci 2022] Croci et al., Stochastic rounding: implementation, error analysis and applications, Royal Society
//!   Open Science 9(3).
//! - [Duff 2017] Duff et al., Building an orthonormal basis, revisited, JCGT 6(1).
//! - [Dupuy 2023] Dupuy, Benyoub, Sampling visible GGX normals with spherical caps, Computer Graphics Forum 42(8).
//! - [Efron 1973] Efron, Morris, Stein's estimation rule and its competitors - an empirical Bayes approach, Journal of
//!   the American Statistical Association 68(341).
//! - [Enderton 2010] Enderton et al., Stochastic transparency, I3D.
//! - [Friedman 2015] Friedman, Jones, Fully automatic ID mattes with support for motion blur and transparency,
//!   SIGGRAPH Posters.
//! - [Gibson 1998] Gibson, Constrained elastic surface nets, MICCAI.
//! - [Giraud 2005] Giraud et al., Rounding error analysis of the classical Gram-Schmidt process, Numerische Mathematik
//!   101.
//! - [glTF 2.0] The Khronos Group, glTF 2.0 Specification, 2021; Appendix B is its BRDF. Extensions by their names:
//!   KHR_lights_punctual, EXT_lights_area (draft), EXT_lights_ies, EXT_lights_image_based, KHR_materials_specular,
//!   KHR_materials_ior, ...
//! - [Graham 1969] Graham, Bounds on multiprocessing timing anomalies, SIAM Journal on Applied Mathematics 17(2).
//! - [Grassmann 1985] Grassmann, Taksar, Heyman, Regenerative analysis and steady state distributions for Markov
//!   chains, Operations Research 33(5).
//! - [Halton 1960] Halton, On the efficiency of certain quasi-random sequences of points, Numerische Mathematik 2.
//! - [Hanika 2021] Hanika, Hacking the shadow terminator, Ray Tracing Gems II, chapter 4.
//! - [Hasan 2006] Hašan, Pellacini, Bala, Direct-to-indirect transfer for cinematic relighting, SIGGRAPH.
//! - [Heitz 2014] Heitz, Understanding the masking-shadowing function in microfacet-based BRDFs, JCGT 3(2).
//! - [Heitz 2016] Heitz, Dupuy, Hill, Neubelt, Real-time polygonal-light shading with linearly transformed cosines,
//!   SIGGRAPH.
//! - [Heitz 2018] Heitz, Sampling the GGX distribution of visible normals, JCGT 7(4).
//! - [Heitz 2018b] Heitz, Hill, McGuire, Combining analytic direct illumination and stochastic shadows, I3D.
//! - [Hosek 2012] Hošek, Wilkie, An analytic model for full spectral sky-dome radiance, SIGGRAPH.
//! - [IES 2002] ANSI/IESNA LM-63-02, the version before the next.
//! - [IES 2019] ANSI/IES LM-63-19, IES Standard File Format for the Electronic Transfer of Photometric Data.
//! - [Ize 2013] Ize, Robust BVH ray traversal, JCGT 2(2).
//! - [James 1961] James, Stein, Estimation with quadratic loss, Berkeley Symposium on Mathematical Statistics.
//! - [Jensen 1996] Jensen, Global illumination using photon maps, Eurographics Workshop on Rendering.
//! - [Joe 2008] Joe, Kuo, Constructing Sobol sequences with better two-dimensional projections, SIAM J. Sci. Comput.
//!   30(5).
//! - [Karis 2013] Karis, Real shading in Unreal Engine 4, SIGGRAPH course.
//! - [Kasson 1995] Kasson, Nin, Plouffe, Hafner, Performing color space conversions with three-dimensional linear
//!   interpolation, Journal of Electronic Imaging 4(3).
//! - [Kautz 1999] Kautz, McCool, Interactive rendering with arbitrary BRDFs using separable approximations, EGWR.
//! - [Keinert 2015] Keinert et al., Spherical Fibonacci mapping, ACM Transactions on Graphics 34(6).
//! - [Keller 2001] Keller, Heidrich, Interleaved sampling, Eurographics Workshop on Rendering.
//! - [Keller 2017] Keller et al., The Iray light transport simulation and rendering system, SIGGRAPH talks.
//! - [Kensler 2006] Kensler, Shirley, Optimizing ray-triangle intersection via automated search, RT.
//! - [Khronos 2024] The Khronos Group, PBR Neutral tone mapper.
//! - [Knaus 2011] Knaus, Zwicker, Progressive photon mapping: a probabilistic approach, ACM TOG 30(3).
//! - [Kopf 2007] Kopf, Cohen, Lischinski, Uyttendaele, Joint bilateral upsampling, SIGGRAPH.
//! - [Kreutzer 2014] Kreutzer et al., A unified sparse matrix data format for efficient general sparse matrix-vector
//!   multiplication on modern processors with wide SIMD units, SIAM Journal on Scientific Computing 36(5).
//! - [Krystek 1985] Krystek, An algorithm to calculate correlated colour temperature, Color Research & Application 10.
//! - [Lindbloom 2017] Lindbloom, Chromatic adaptation, brucelindbloom.com.
//! - [Lloyd 1982] Lloyd, Least squares quantization in PCM, IEEE Transactions on Information Theory 28(2).
//! - [Matousek 1998] Matousek, On the L2-discrepancy for anchored boxes, J. Complexity 14(4).
//! - [Narkowicz 2015] Narkowicz, ACES filmic tone mapping curve.
//! - [Ng 2003] Ng, Ramamoorthi, Hanrahan, All-frequency shadows using non-linear wavelet lighting approximation,
//!   SIGGRAPH.
//! - [OpenGL 4.6] The Khronos Group, The OpenGL Graphics System: A Specification, version 4.6, core profile, 2022.
//! - [OpenJD 2023] Open Job Description, Template schemas, version 2023-09.
//! - [Peter 1998] Peter, Pietrek, Importance driven construction of photon maps, Eurographics Workshop on Rendering.
//! - [Poulin 1992] Poulin, Fournier, Lights from highlights and shadows, I3D.
//! - [Preetham 1999] Preetham, Shirley, Smits, A practical analytic model for daylight, SIGGRAPH.
//! - [Reeves 1987] Reeves, Salesin, Cook, Rendering antialiased shadows with depth maps, SIGGRAPH.
//! - [Reinhard 2002] Reinhard et al., Photographic tone reproduction for digital images, SIGGRAPH.
//! - [RFC 7396] Hoffman, Snell, JSON Merge Patch, Internet Engineering Task Force, 2014.
//! - [RP 177-1993] SMPTE, Derivation of basic television color equations.
//! - [S-2014-004] Academy of Motion Picture Arts and Sciences, ACEScg: a working space for CGI render and compositing.
//! - [Saad 1986] Saad, Schultz, GMRES: a generalized minimal residual algorithm, SIAM Journal on Scientific and
//!   Statistical Computing 7(3).
//! - [Schlick 1994] Schlick, An inexpensive BRDF model for physically-based rendering, Computer Graphics Forum 13(3).
//! - [Sinkhorn 1967] Sinkhorn, Knopp, Concerning nonnegative matrices and doubly stochastic matrices, Pacific Journal
//!   of Mathematics 21(2).
//! - [Sobotka 2022] Sobotka, AgX; [Wrensch 2023] Wrensch, Minimal AgX implementation.
//! - [Steele 2014] Steele, Lea, Flood, Fast splittable pseudorandom number generators, OOPSLA.
//! - [Sutherland 1974] Sutherland, Hodgman, Reentrant polygon clipping, Communications of the ACM.
//! - [UsdLux 2025] Pixar Animation Studios, UsdLux: USD lighting schema, documentation of OpenUSD 25.11.
//! - [van der Corput 1935] van der Corput, Verteilungsfunktionen, Proc. Ned. Akad. v. Wet. 38.
//! - [Veach 1995] Veach, Guibas, Optimally combining sampling techniques for Monte Carlo rendering, SIGGRAPH.
//! - [Veach 1997] Veach, Robust Monte Carlo methods for light transport simulation, dissertation, Stanford University.
//! - [Walter 2007] Walter et al., Microfacet models for refraction through rough surfaces, EGSR.
//! - [Ward 1988] Ward, Rubinstein, Clear, A ray tracing solution for diffuse interreflection, SIGGRAPH.
//! - [Wilson 1931] Wilson, Hilferty, The distribution of chi-square, PNAS 17(12).
//! - [Wyman 2013] Wyman, Sloan, Shirley, Simple analytic approximations to the CIE XYZ color matching functions,
//!   JCGT 2(2).
//! - [Yang 2007] Yang, Glossy direct-to-indirect transfer for relighting, Master thesis, National Taiwan University.

pub mod bake;
pub mod desk;
pub mod error;
pub mod final_gather;
pub mod gpu;
pub mod image;
pub mod physics;
pub mod reference;
pub mod relight;
pub mod report;
pub mod scene;
pub mod session;
pub mod shared;
pub mod storage;
pub mod trace;
pub mod view;
pub mod wire;

pub use error::{Error, Result};
pub use session::{Session, SessionSettings};
