// The questions that the page asks: for a token, and before anything is lost.

import { h } from "./dom.js";

function shown(dialog) {
  document.body.append(dialog);
  dialog.addEventListener("close", () => dialog.remove());
  dialog.showModal();
}

/** Whether the person means it. */
export function confirmed(title, text, action) {
  return new Promise((resolve) => {
    const form = h("form", { method: "dialog" },
      h("h2", { id: "question" }, title),
      h("p", {}, text),
      h("div.buttons", {},
        h("button", { value: "no", autofocus: true }, "Keep"),
        h("button.danger", { value: "yes" }, action)));
    const dialog = h("dialog", { "aria-labelledby": "question" }, form);
    dialog.addEventListener("close", () => resolve(dialog.returnValue === "yes"));
    shown(dialog);
  });
}

/** A token from the person; asked again until one is given. */
export function askForToken(refused) {
  return new Promise((resolve) => {
    const input = h("input", { type: "password", name: "token", autocomplete: "off", required: true, "aria-describedby": "token-note" });
    const form = h("form", { method: "dialog" },
      h("h2", { id: "token-title" }, "This service needs a token"),
      h("p", { id: "token-note", role: refused ? "alert" : null }, refused
        ? "That token was not accepted. Tokens can be revoked and can run out."
        : "Whoever runs the service gives it out. It is kept until this tab is closed."),
      h("label", {}, "Token", input),
      h("div.buttons", {}, h("button.primary", { value: "ok" }, "Continue")));
    const dialog = h("dialog", { "aria-labelledby": "token-title" }, form);
    dialog.addEventListener("cancel", (event) => event.preventDefault());
    dialog.addEventListener("close", () => {
      const given = input.value.trim();
      resolve(given || askForToken(refused));
    });
    shown(dialog);
    input.focus();
  });
}
