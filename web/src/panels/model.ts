// Which model of coils and magnets the controller inverts, and a switch to another one.

import { at, make, write } from "./dom";

/** What each model is, in a few words; a device of another kind has its own names. */
const ABOUT: Record<string, string> = {
  exact: "exact: the tool's true size, and the core's pull compensated",
  published: "published: the paper's point dipoles",
};

export class ModelPanel {
  private readonly select = at<HTMLSelectElement>("model");

  constructor(
    private readonly models: string[],
    send: (command: Record<string, unknown>) => void,
  ) {
    at("model-row").hidden = models.length < 2;
    this.select.append(...models.map((name) => make("option", { value: name, title: ABOUT[name] ?? name }, name)));
    this.select.addEventListener("change", () => {
      send({ do: "model", model: this.select.value });
      write(at("polite"), `The controller goes over to the model ${ABOUT[this.select.value] ?? this.select.value}.`);
    });
  }

  enable(yes: boolean): void {
    this.select.disabled = !yes;
  }

  show(name: string): void {
    if (this.models.includes(name)) this.select.value = name;
    this.select.title = ABOUT[name] ?? "";
  }
}
