// The live page in a notebook: in its own frame; its requests travel through the kernel's channel.

function render({ model, el }) {
  const frame = document.createElement('iframe');
  frame.setAttribute('sandbox', 'allow-scripts allow-downloads');
  frame.title = 'etendue';
  frame.style.cssText = 'width: 100%; border: 0; border-radius: 8px;';
  frame.style.height = `${model.get('height')}px`;
  const asked = (event) => { if (event.source === frame.contentWindow && event.data && event.data.etendue) model.send(event.data); };
  const told = (answer, buffers) => {
    const body = buffers && buffers.length ? new Uint8Array(buffers[0].buffer || buffers[0], buffers[0].byteOffset || 0, buffers[0].byteLength).slice().buffer : new ArrayBuffer(0);
    if (frame.contentWindow) frame.contentWindow.postMessage({ ...answer, body }, '*');
  };
  window.addEventListener('message', asked);
  model.on('msg:custom', told);
  frame.srcdoc = model.get('html');
  el.append(frame);
  return () => { window.removeEventListener('message', asked); model.off('msg:custom', told); };
}

export default { render };
