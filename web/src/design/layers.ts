// Two canvases one above the other: what is drawn once, and what follows the pointer.

export class Layers {
  readonly box = document.createElement("div");
  private readonly canvases = [document.createElement("canvas"), document.createElement("canvas")] as const;
  width = 0;
  height = 0;

  /** `redraw` is called whenever the size or the theme has changed. */
  constructor(className: string, redraw: () => void) {
    this.box.className = `layers ${className}`;
    for (const canvas of this.canvases) {
      canvas.ariaHidden = "true";
      this.box.append(canvas);
    }
    new ResizeObserver(() => {
      this.fit();
      redraw();
    }).observe(this.box);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  }

  private fit(): void {
    const density = devicePixelRatio;
    [this.width, this.height] = [this.box.clientWidth, this.box.clientHeight];
    for (const canvas of this.canvases) {
      canvas.width = Math.round(this.width * density);
      canvas.height = Math.round(this.height * density);
    }
  }

  /** An empty layer to draw on, in CSS pixels: 0 below, 1 above. */
  clear(layer: 0 | 1): CanvasRenderingContext2D {
    const context = this.canvases[layer].getContext("2d")!;
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    context.clearRect(0, 0, this.width, this.height);
    context.font = `13px ${getComputedStyle(this.box).fontFamily}`;
    return context;
  }

  /** The lower layer as it is, to draw more on it. */
  get below(): CanvasRenderingContext2D {
    return this.canvases[0].getContext("2d")!;
  }

  /** Where a pointer is, in CSS pixels of the layers. */
  place({ clientX, clientY }: PointerEvent | MouseEvent): [number, number] {
    const { left, top } = this.box.getBoundingClientRect();
    return [clientX - left, clientY - top];
  }
}
