// Shows the OpenAPI document as a page.

const api = await (await fetch("/openapi.json")).json();
document.querySelector("#about").textContent = `${api.info.summary} Version ${api.info.version}.`;

function element(name, text, className) {
  const made = document.createElement(name);
  if (text) made.textContent = text;
  if (className) made.className = className;
  return made;
}

/** A text with its `names` set as code. */
function prose(text = "") {
  const paragraph = element("p");
  paragraph.append(...text.split("`").map((part, index) => (index % 2 ? element("code", part) : part)));
  return paragraph;
}

function parameters(operation) {
  const rows = (operation.parameters ?? []).map((one) => {
    const item = element("li");
    item.append(element("code", one.name), ` in ${one.in}${one.required ? ", required" : ""}`);
    return item;
  });
  const box = element("ul");
  box.append(...rows);
  return rows.length ? [box] : [];
}

function schemaBox(title, schema) {
  const box = element("details");
  box.append(element("summary", title), element("pre", JSON.stringify(schema, null, 2)));
  return box;
}

const calls = document.querySelector("#calls");
for (const [path, methods] of Object.entries(api.paths)) {
  for (const [method, operation] of Object.entries(methods)) {
    const section = element("section", "", "call");
    section.append(element("h3", `${method.toUpperCase()} ${path}`), prose(operation.description), ...parameters(operation));
    for (const [type, { schema }] of Object.entries(operation.requestBody?.content ?? {})) section.append(schemaBox(`Body: ${type}`, schema));
    for (const [status, reply] of Object.entries(operation.responses)) section.append(schemaBox(`${status}: ${reply.description}`, reply.content ?? {}));
    calls.append(section);
  }
}
calls.append(element("h2", "Schemas"));
for (const [name, schema] of Object.entries(api.components.schemas)) calls.append(schemaBox(name, schema));
