// node check.mjs FOLDER: JSON lines {file, line, text} of what is wrong with the scripts in FOLDER: errors of `tsc --checkJs`,
// and each field that is read of a value without a type, because the compiler checks no such read.

import { readdirSync } from "node:fs";
import { basename, join } from "node:path";
import ts from "typescript";

const folder = process.argv[2];
const names = readdirSync(folder).filter((name) => /\.(js|d\.ts)$/.test(name));
const program = ts.createProgram(names.map((name) => join(folder, name)), {
  allowJs: true, checkJs: true, noEmit: true, target: ts.ScriptTarget.ESNext, module: ts.ModuleKind.ESNext, strict: false,
  moduleResolution: ts.ModuleResolutionKind.Bundler, lib: ["lib.esnext.d.ts", "lib.dom.d.ts", "lib.dom.iterable.d.ts", "lib.dom.asynciterable.d.ts"], types: [],
});
const checker = program.getTypeChecker();

function tell(source, position, text) {
  const { line } = source.getLineAndCharacterOfPosition(position);
  console.log(JSON.stringify({ file: basename(source.fileName), line: line + 1, text }));
}

for (const { file, start, messageText } of ts.getPreEmitDiagnostics(program)) {
  tell(file, start, ts.flattenDiagnosticMessageText(messageText, " "));
}

const untyped = (node) => Boolean(checker.getTypeAtLocation(node).flags & ts.TypeFlags.Any);

function visit(source, node) {
  const read = ts.isPropertyAccessExpression(node) ? node.expression : ts.isObjectBindingPattern(node) ? node : null;
  if (read && untyped(read)) tell(source, node.getStart(source), `a field of a value without a type: ${node.getText(source).slice(0, 60)}`);
  ts.forEachChild(node, (child) => visit(source, child));
}

for (const source of program.getSourceFiles()) if (source.fileName.endsWith(".js")) visit(source, source);
