// Lightmaps of glTF files (MOZ_lightmap) in three.js:
//
//   const loader = new GLTFLoader();
//   loader.register((parser) => new LightmapExtension(parser));
//   const gltf = await loader.loadAsync("hall_lit.glb");
//   removeLights(gltf.scene);  // their light is in the lightmap
//
// With a lightmap in lux (antumbra bake --what light) a surface has the radiance that the baked lights would give it.
// three.js releases with GLTFLightMapLoaderExtension among their addons have the same class.
import {LinearSRGBColorSpace} from "three";

export class LightmapExtension {
  constructor(parser) {
    this.parser = parser;
    this.name = "MOZ_lightmap";
  }

  loadMaterial(index) {
    const {parser, name} = this;
    const lightmap = parser.json.materials[index].extensions?.[name];
    if (lightmap === undefined) return null;
    return parser.loadMaterial(index).then(async (material) => {
      const texture = await parser.getDependency("texture", lightmap.index);
      material.lightMap = texture.clone();
      material.lightMap.colorSpace = LinearSRGBColorSpace;
      material.lightMap.channel = lightmap.texCoord ?? 1;
      material.lightMapIntensity = lightmap.intensity ?? 1;
      return material;
    });
  }
}

export function removeLights(scene) {
  const lights = [];
  scene.traverse((object) => object.isLight && lights.push(object));
  for (const light of lights) light.removeFromParent();
}
