// Every produced glTF file against the Khronos validator: no error, and no warning that its input did not have.
//
//   node validate.mjs FOLDER [--verbose]

import { readFileSync } from "node:fs";
import path from "node:path";
import { validateBytes, version } from "gltf-validator";
import { readCases, report } from "./cases.mjs";

const ERROR = 0;
const WARNING = 1;

async function issuesOf(file) {
  const bytes = new Uint8Array(readFileSync(file));
  const result = await validateBytes(bytes, {
    uri: path.basename(file),
    maxIssues: 0,
    externalResourceFunction: async (uri) => new Uint8Array(readFileSync(path.join(path.dirname(file), uri))),
  });
  return result.issues.messages;
}

/** How often each warning code occurs. */
function warnings(issues) {
  const counts = new Map();
  for (const { code, severity } of issues) {
    if (severity === WARNING) counts.set(code, (counts.get(code) ?? 0) + 1);
  }
  return counts;
}

async function check({ name, input, output }, folder) {
  const issues = await issuesOf(path.join(folder, output));
  const before = input ? warnings(await issuesOf(path.join(folder, input))) : new Map();
  const problems = issues
    .filter(({ severity }) => severity === ERROR)
    .map(({ code, message, pointer }) => `${code} at ${pointer}: ${message}`);
  for (const [code, count] of warnings(issues)) {
    const allowed = before.get(code) ?? 0;
    if (count > allowed) {
      const first = issues.find((issue) => issue.code === code);
      problems.push(`${count} warnings ${code} where the input has ${allowed}, first at ${first.pointer}: ${first.message}`);
    }
  }
  return { name, problems: problems.slice(0, 5) };
}

const { folder, cases } = readCases(process.argv);
const results = [];
for (const item of cases) results.push(await check(item, folder));
report(`glTF validator ${version()}`, results);
