export {
  AmbientLight, BufferAttribute, BufferGeometry, Color, DirectionalLight, Mesh, MeshLambertMaterial, PerspectiveCamera,
  Scene, SRGBColorSpace, Vector3, WebGLRenderer,
} from "three";
