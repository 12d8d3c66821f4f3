// The cases that rig_cases.py wrote: one entry per produced file, in `cases.json` of the outputs' folder.
//
//   { "name": "sample", "input": "path or null", "output": "sample.glb", "pose": "sample.pose.json" }
//
// `input` is relative to the folder; null where the input is no glTF file. `pose` holds a pose and where our own linear
// blend skinning puts every vertex in it.

import { readFileSync } from "node:fs";
import path from "node:path";

export function readCases(argv) {
  const folder = argv[2];
  if (!folder) {
    console.error("usage: node <check>.mjs FOLDER   (a folder that rig_cases.py filled)");
    process.exit(2);
  }
  const cases = JSON.parse(readFileSync(path.join(folder, "cases.json"), "utf8"));
  return { folder: path.resolve(folder), cases };
}

/** Prints one line per failed case and the summary that `make test` adds up; exits with 1 if any case failed. */
export function report(what, results) {
  const failed = results.filter((result) => result.problems.length > 0);
  for (const { name, problems } of failed) {
    for (const problem of problems) console.log(`FAILED ${what}: ${name}: ${problem}`);
  }
  console.log(`${what}: ${results.length - failed.length} passed, ${failed.length} failed`);
  if (results.length === 0) console.log(`FAILED ${what}: there was nothing to check`);
  process.exit(failed.length > 0 || results.length === 0 ? 1 : 0);
}
