//% for part in assembled
// @{ part.kind } of @{ part.slots }, from @{ "pairs" if part.params | length > 1 else "the pair" } @{ part.numbers } of @{ pairs | length }.
fn skinbake_@{ part.name }(@{ part.params | join(": vec2<f32>, ") }: vec2<f32>) -> @{ types[part.type] } {
    return @{ types[part.type] }(@{ part.components | join(", ") });
}
@{ "" }
//% endfor
