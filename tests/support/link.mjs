// Link WESL to WGSL with the linker of the WESL working group (npm: wesl).
//
// On stdin {"modules": {"render/skinning.wesl": text}, "jobs": {name: {"text": text, "conditions": [flag]}}}:
// the modules are those of the package bevy_pbr. On stdout {name: {"wgsl": text}} or {name: {"error": message}}.

import { readFileSync } from "node:fs";

// The linker says on stdout what it throws as well, by the function that it finds when it is loaded.
console.log = console.error = () => {};
const { link } = await import("wesl");

const { modules, jobs } = JSON.parse(readFileSync(0, "utf8"));
const library = { name: "bevy_pbr", edition: "unstable_2025_1", modules };
const answers = {};
for (const [name, { text, conditions }] of Object.entries(jobs)) {
    try {
        const linked = await link({
            weslSrc: { "./main.wesl": text },
            rootModuleName: "main",
            libs: [library],
            conditions: Object.fromEntries(conditions.map((flag) => [flag, true])),
            keepComments: false,
            sourceMap: false,
        });
        answers[name] = { wgsl: linked.dest };
    } catch (error) {
        answers[name] = { error: String(error.message ?? error) };
    }
}
process.stdout.write(JSON.stringify(answers));
