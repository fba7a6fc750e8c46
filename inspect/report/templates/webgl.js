"use strict";
// What pages that draw with WebGL share.
const DATA = JSON.parse(document.getElementById("data").textContent);
const $ = id => document.getElementById(id);
const rad = degrees => degrees * Math.PI / 180;
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));

function linked(gl, vertex, fragment) { // a program, and the places of its uniforms by name
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  const places = {};
  return {made, at: name => places[name] ??= gl.getUniformLocation(made, name)};
}
