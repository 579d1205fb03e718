//! Derive macros in place of Bevy's: each implements its trait for a struct without type parameters.

extern crate proc_macro;

use proc_macro::{TokenStream, TokenTree};

/// The name behind the word `struct`.
fn name(input: TokenStream) -> String {
    let mut tokens = input.into_iter();
    tokens
        .find(|token| matches!(token, TokenTree::Ident(word) if word.to_string() == "struct"))
        .expect("a struct");
    tokens.next().expect("its name").to_string()
}

#[proc_macro_derive(Asset)]
pub fn asset(input: TokenStream) -> TokenStream {
    let name = name(input);
    format!("impl ::bevy::asset::VisitAssetDependencies for {name} {{}} impl ::bevy::asset::Asset for {name} {{}}")
        .parse()
        .unwrap()
}

#[proc_macro_derive(TypePath)]
pub fn type_path(input: TokenStream) -> TokenStream {
    let name = name(input);
    format!("impl ::bevy::reflect::TypePath for {name} {{}}")
        .parse()
        .unwrap()
}

#[proc_macro_derive(AsBindGroup)]
pub fn as_bind_group(input: TokenStream) -> TokenStream {
    let name = name(input);
    format!("impl ::bevy::render::render_resource::AsBindGroup for {name} {{ type Data = (); }}")
        .parse()
        .unwrap()
}
