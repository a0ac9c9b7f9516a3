// Cached image of the static part of the scene, shown below the canvas with the moving part.

export class Backdrop {
  private readonly picture = document.createElement("canvas");
  // A bitmaprenderer context only shows an image; browsers copy a 2D canvas in every frame.
  private readonly context: ImageBitmapRenderingContext;
  /** number of captures, for tests */
  captures = 0;
  valid = false;

  constructor(canvas: HTMLCanvasElement) {
    this.picture.className = "backdrop";
    this.picture.ariaHidden = "true";
    this.picture.hidden = true;
    this.context = this.picture.getContext("bitmaprenderer")!;
    canvas.before(this.picture);
  }

  /** Capture the present content of `canvas`. */
  capture(canvas: HTMLCanvasElement): void {
    const copy = new OffscreenCanvas(canvas.width, canvas.height);
    copy.getContext("2d")!.drawImage(canvas, 0, 0);
    this.context.transferFromImageBitmap(copy.transferToImageBitmap());
    this.picture.hidden = false;
    this.valid = true;
    this.captures++;
  }

  /** Hide the outdated image. */
  invalidate(): void {
    this.valid = false;
    if (!this.picture.hidden) this.picture.hidden = true;
  }
}
