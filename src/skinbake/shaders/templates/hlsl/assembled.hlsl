//% for part in assembled
//% set guard = "SKINBAKE_" ~ part.name | upper
#ifndef @{ guard }
#define @{ guard }
// @{ part.kind } of @{ part.slots }, from @{ "pairs" if part.params | length > 1 else "the pair" } @{ part.numbers } of @{ pairs | length }.
@{ types[part.type] } skinbake_@{ part.name }(@{ part.params | map("replace", "pair", "float2 pair") | join(", ") })
{
    return @{ types[part.type] }(@{ part.components | join(", ") });
}
#endif
@{ "" }
//% endfor
