// Selection of the controller model.

import { at, make, write } from "./dom";

export class ModelPanel {
  private readonly select = at<HTMLSelectElement>("model");

  constructor(models: string[], send: (command: Record<string, unknown>) => void) {
    at("model-row").hidden = models.length < 2;
    this.select.append(...models.map((name) => make("option", {}, name)));
    this.select.addEventListener("change", () => {
      send({ do: "model", model: this.select.value });
      write(at("polite"), `Controller model ${this.select.value}.`);
    });
  }

  enable(yes: boolean): void {
    this.select.disabled = !yes;
  }

  show(name: string): void {
    this.select.value = name;
  }
}
